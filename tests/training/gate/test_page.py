"""The page of a verdict."""

import json
import re
from dataclasses import replace

from tests.training.gate.test_verdict import check, verdict
from training.gate.page import page_of
from training.gate.verdict import verdict_digest


def test_the_page_says_who_did_not_pass_and_why():
    page = page_of(verdict(check("error"), replace(check("parity", passed=False), sentence="it differs by 0.1")))
    assert "not passed" in page
    assert re.search(r"Why it does not pass.*parity.*it differs by 0\.1", page)
    assert page.index(">parity<") < page.index(">error<")


def test_a_page_of_a_challenger_that_passed_names_no_failure():
    page = page_of(verdict())
    assert "Why it does not pass" not in page
    assert verdict_digest(verdict()) in page


def test_the_page_needs_no_other_file_and_holds_every_picture():
    page = page_of(verdict())
    assert not re.search(r"""<(script|link|img)[^>]+(src|href)=""", page)
    embedded = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert embedded
    figures = json.loads(embedded[1])
    assert set(figures) == set(re.findall(r'data-figure="([^"]+)"', page)) == {"figure-0"}


def test_what_others_wrote_cannot_become_part_of_the_page():
    page = page_of(verdict(replace(check("error"), sentence="</td><script>alert(1)</script>")))
    assert "<script>alert(1)" not in page
