"""Tables that are written anew between their marks."""

import math

from training.marked_tables import in_four_digits, marks_of, percent, table, with_tables

PAGE = """before
<!-- table: one.cells -->
old
<!-- end of table -->
between
<!-- table: two -->
kept
<!-- end of table -->
"""


def test_a_table_is_written_between_its_marks():
    page = with_tables(PAGE, {"one.cells": "| new |\n", "two": None}.__getitem__)
    assert "| new |" in page
    assert "old" not in page
    assert page.startswith("before\n")


def test_without_a_table_the_page_stays():
    assert with_tables(PAGE, lambda _: None) == PAGE


def test_writing_twice_changes_nothing():
    once = with_tables(PAGE, lambda name: table(("a", "b"), [[name, "1"]]))
    assert with_tables(once, lambda name: table(("a", "b"), [[name, "1"]])) == once


def test_the_marks_are_named_in_order():
    assert marks_of(PAGE) == ["one.cells", "two"]


def test_a_table_has_a_line_per_row():
    assert table(("a", "b"), [["1", "2"]]) == "| a | b |\n|---|---|\n| 1 | 2 |\n"


def test_figures_keep_four_digits_wherever_they_are():
    assert in_four_digits({"a": [0.123456, (1234567.0, 3)], "b": "text"}) == {
        "a": [0.1235, [1235000.0, 3]],
        "b": "text",
    }


def test_percent_says_so():
    assert percent(0.0123) == "1.2 %"
    assert percent(1.0, digits=0) == "100 %"


def test_what_is_not_a_number_stays_none():
    assert math.isnan(in_four_digits(math.nan))
