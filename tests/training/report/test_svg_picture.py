"""Pictures as SVG: all kinds, small, and the same every time."""

from xml.etree import ElementTree as ET

import pytest

from tests.training.study.fake_chapters import fake_result
from training.report.svg_picture import MOST_POINTS_COUNT, svg_of, thinned
from training.study.picture import Axis, Bars, Cloud, Line, Lines, Scatter

PICTURES = {type(picture).__name__: picture for picture in fake_result().pictures}


@pytest.mark.parametrize("kind", PICTURES)
def test_a_picture_is_the_same_byte_for_byte_and_small(kind):
    first, again = svg_of(PICTURES[kind]), svg_of(PICTURES[kind])
    assert first == again
    assert first.startswith(b"<?xml")
    assert PICTURES[kind].title.split()[0].encode() in first
    assert len(first) < 60_000


def test_clouds_share_the_points_that_are_shown():
    clouds = tuple(Cloud(name, tuple(map(float, range(9000))), (1.0,) * 9000) for name in "ab")
    assert len(svg_of(Scatter("s", Axis("x"), Axis("y"), clouds))) < 60_000


def test_a_thinned_cloud_keeps_its_ends():
    cloud = Cloud("c", tuple(map(float, range(9000))), tuple(map(float, range(9000))))
    shown = thinned(cloud, most_count=MOST_POINTS_COUNT)
    assert len(shown.x) == len(shown.y) == MOST_POINTS_COUNT
    assert (shown.x[0], shown.x[-1]) == (0.0, 8999.0)
    assert thinned(shown, most_count=MOST_POINTS_COUNT) is shown


def test_a_picture_of_nothing_is_drawn_nevertheless():
    assert svg_of(Bars("none", "bin", Axis("count"), (), ())).startswith(b"<?xml")


@pytest.mark.parametrize(("lines_count", "inside"), [(6, True), (7, False)])
def test_a_legend_of_many_lines_stands_outside_the_drawing(lines_count, inside):
    lines = tuple(Line(f"line {i}", (0.0, 1.0), (float(i), 1.0)) for i in range(lines_count))
    drawn = ET.fromstring(svg_of(Lines("many", Axis("x"), Axis("y"), lines)))  # noqa: S314 - our own file
    groups = {group.get("id"): group for group in drawn.iter("{http://www.w3.org/2000/svg}g")}
    assert (groups["legend_1"] in list(groups["axes_1"])) is inside
