"""The file of thresholds: whole, strict, and named by its values."""

import tomllib
from dataclasses import replace
from importlib.resources import files

import pytest

from training.gate.thresholds import (
    ThresholdsError,
    default_thresholds,
    read_thresholds,
    thresholds_document,
    thresholds_from_document,
    thresholds_from_toml,
    thresholds_sha256,
)


@pytest.fixture
def text():
    return (files("training.gate") / "thresholds.toml").read_text(encoding="utf-8")


def test_the_packaged_file_holds_what_is_asked_and_nothing_else(text):
    assert thresholds_document(thresholds_from_toml(text)) == tomllib.loads(text)


def test_thresholds_come_back_from_their_document():
    assert thresholds_from_document(thresholds_document(default_thresholds())) == default_thresholds()


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("tolerance_mu = 1e-5", "", "parity.tolerance_mu is missing"),
        ("tolerance_mu = 1e-5", "tolerance_mu = 1e-5\nspare = 1", "parity.spare is asked by nobody"),
        ("tolerance_mu = 1e-5", "tolerance_mu = '1e-5'", "parity.tolerance_mu must be a number"),
        ("tolerance_mu = 1e-5", "tolerance_mu = nan", "parity.tolerance_mu must be a number"),
        ("tolerance_mu = 1e-5", "tolerance_mu = -1e-5", "zero or more"),
        ("rows_count = 10000", "rows_count = 10000.5", "a whole number"),
        ("required = true  ", "required = 1  ", "true or false"),
        ('"manoeuvres"]', '"parking"]', "parking is none of"),
        ("manoeuvres = 0.01, measured", "measured", "paired.tolerance_ratio needs a figure for each"),
        ("factors_ratio = [1.1", "factors_ratio = [0.9", "a factor above one"),
        ("confidence_frac = 0.95", "confidence_frac = 1.0", "a confidence"),
        ("[drift]", "[[drift]]", "drift must be a table"),
        ("[drift]", "[drift", "no TOML"),
    ],
)
def test_what_is_not_whole_is_refused_by_name(text, was, becomes, said):
    assert was in text
    with pytest.raises(ThresholdsError, match=said.replace("[", r"\[")):
        thresholds_from_toml(text.replace(was, becomes, 1))


def test_the_digest_is_that_of_the_values_not_of_the_words_beside_them(text):
    plain = thresholds_from_toml("\n".join(line.split("#")[0] for line in text.splitlines()))
    assert thresholds_sha256(plain) == thresholds_sha256(default_thresholds())
    laxer = replace(plain, parity=replace(plain.parity, tolerance_mu=1e-4))
    assert thresholds_sha256(laxer) != thresholds_sha256(plain)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ThresholdsError, match=r"mine\.toml"):
        read_thresholds(tmp_path / "mine.toml")
