"""A result comes back from JSON as it was, whichever library its numbers are of."""

import json
import math
from typing import Any

import numpy as np
import pytest

from tests.training.study.fake_chapters import fake_result
from training.study.chapter import Result, Table
from training.study.documents import document_of, in_short, picture_of, result_of
from training.study.picture import Axis, Line, Lines


def there_and_back(result: Result) -> Result:
    return result_of(json.loads(json.dumps(document_of(result), allow_nan=False)))


def test_a_result_with_every_kind_of_picture_comes_back():
    assert repr(there_and_back(fake_result())) == repr(fake_result())


def test_numbers_of_numpy_become_plain_ones():
    # What a chapter may hand over in spite of the types it promises.
    numbers: Any = np.array([1.5, 2.5])
    half, three = np.float32(0.5), np.int64(3)
    cells: Any = (np.int64(1), np.float64(2.5), np.str_("x"))
    picture_given = Lines("l", Axis("x"), Axis("y"), (Line("n", numbers, numbers),))
    odd: Any = ({"mape": half}, {"rows_count": three}, (Table("t", ("a", "b", "c"), (cells,)),), (picture_given,))
    result = Result(*odd)
    back = there_and_back(result)
    assert back.figures == {"mape": 0.5}
    assert back.sizes == {"rows_count": 3}
    assert back.tables[0].rows == ((1, 2.5, "x"),)
    (picture,) = back.pictures
    assert isinstance(picture, Lines)
    assert picture.lines[0].x == (1.5, 2.5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_finite_number_comes_back_as_none_at_all(value):
    assert math.isnan(there_and_back(Result({"x": value}, {})).figures["x"])


def test_rounding_keeps_six_digits_and_all_else():
    assert in_short({"a": [0.123456789, 3, "x", None, True]}) == {"a": [0.123457, 3, "x", None, True]}


def test_a_picture_of_no_kind_is_refused():
    with pytest.raises(KeyError, match="pie"):
        picture_of({"kind": "pie", "title": "", "y_axis": {"title": ""}})
