"""The driving envelope: the density is that of a mixture, and what lies far from all kinds is strange."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.envelope import DrivingEnvelope
from rsu_app.domain.envelope import is_strange, is_strange_driving, is_strange_road, prepared, strangeness_level
from tests.bundles import make_ordinary

NAMES = ("other", "a", "b")
ONE = DrivingEnvelope(
    columns=("b", "a"),
    lower=(0.5, -6.0),
    upper=(1.5, 2.0),
    cut_ratio=10.0,
    share_frac=(1.0,),
    middle_ratio=((0.0, 0.0),),
    whitening_ratio=(((1.0, 0.0), (0.0, 1.0)),),
    limit_level=8.0,
)
TWO = replace(
    ONE,
    share_frac=(0.25, 0.75),
    middle_ratio=((0.0, 0.0), (3.0, -1.0)),
    whitening_ratio=(((1.0, 0.0), (0.0, 1.0)), ((2.0, 0.0), (0.5, 1.0))),
)


def row(*, a: float, b: float) -> np.ndarray:
    return np.array([[99.0, a, b]])


def test_a_single_bell_has_its_density():
    level = strangeness_level(row(a=-2.0 + 4.0 * 0.3, b=1.0 + 0.5 * 2.0), prepared(ONE, NAMES))
    assert level[0] == pytest.approx(np.log(2.0 * np.pi) + 0.5 * (0.3**2 + 2.0**2))


def test_a_mixture_adds_the_densities_of_its_kinds():
    at = np.array([1.5, 0.5])
    density = 0.0
    for share, middle, whitening in zip(TWO.share_frac, TWO.middle_ratio, TWO.whitening_ratio, strict=True):
        w = np.array(whitening)
        covariance = np.linalg.inv(w.T @ w)
        off = at - np.array(middle)
        height = share / (2.0 * np.pi * np.sqrt(np.linalg.det(covariance)))
        density += height * np.exp(-0.5 * off @ np.linalg.inv(covariance) @ off)
    level = strangeness_level(row(a=-2.0 + 4.0 * at[1], b=1.0 + 0.5 * at[0]), prepared(TWO, NAMES))
    assert level[0] == pytest.approx(-np.log(density))


def test_columns_are_found_by_name():
    one = strangeness_level(row(a=1.0, b=2.0), prepared(TWO, NAMES))
    other = strangeness_level(np.array([[2.0, 1.0]]), prepared(TWO, ("b", "a")))
    assert one[0] == other[0]


def test_a_row_without_a_column_is_refused():
    with pytest.raises(ValueError, match="asks for b"):
        prepared(ONE, ("a", "other"))


@given(st.floats(0.0, 20.0), st.floats(1.0, 3.0))
def test_further_out_is_never_less_strange(distance: float, factor: float):
    near, far = (
        strangeness_level(row(a=-2.0 + 4.0 * d, b=1.0), prepared(ONE, NAMES))[0] for d in (distance, factor * distance)
    )
    assert far >= near - 1e-9


def test_what_is_beyond_measure_is_strange_and_finite():
    levels = strangeness_level(row(a=1e30, b=-1e30), prepared(TWO, NAMES))
    assert np.isfinite(levels).all()
    assert is_strange(row(a=1e30, b=-1e30), prepared(TWO, NAMES)).all()
    assert not is_strange(row(a=-2.0, b=1.0), prepared(TWO, NAMES)).any()


@pytest.mark.parametrize(
    "change",
    [
        {"lower": (1.0,)},
        {"upper": (1.5, -6.0)},
        {"share_frac": (0.0,)},
        {"middle_ratio": ((0.0, np.nan),)},
        {"whitening_ratio": (((1.0, 0.0), (0.0, 0.0)),)},
        {"cut_ratio": 0.0},
        {"columns": ()},
    ],
)
def test_a_record_that_contradicts_itself_is_refused(change: dict[str, Any]):
    with pytest.raises(ValueError, match=r"."):
        replace(ONE, **change)


def test_many_envelopes_take_turns_and_none_takes_the_place_of_another():
    made = [replace(make_ordinary(), driving=replace(TWO, limit_level=float(level))) for level in range(40)]
    rows = row(a=1.0, b=2.0)
    level = strangeness_level(rows, prepared(TWO, NAMES))[0]
    for _ in range(2):
        strange = [bool(is_strange_driving(rows, one, NAMES)[0]) for one in made]
        assert strange == [level > one.driving.limit_level for one in made]


def test_a_road_is_judged_by_its_own_features():
    names = ("speed_mean_mps", "section_length_m")
    rows = np.array([[900.0, 300.0], [15.0, 700.0]])
    assert is_strange_road(rows, make_ordinary(), names).tolist() == [False, True]
