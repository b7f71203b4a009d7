"""The picture in the docs is the one that its command draws."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from training.scenario_picture import main, picture_svg, scenario_sketches


def test_the_committed_picture_is_what_the_command_draws(project_root: Path, tmp_path: Path) -> None:
    assert main([str(tmp_path / "picture.svg")]) == 0
    drawn = (tmp_path / "picture.svg").read_text(encoding="utf-8")
    assert drawn == (project_root / "docs" / "pictures" / "scenarios.svg").read_text(encoding="utf-8")


def test_without_a_file_the_command_says_how_it_is_used(capsys) -> None:
    assert main([]) == 2
    assert "FILE.svg" in capsys.readouterr().err


def test_every_scenario_has_its_line_within_the_picture() -> None:
    sketches = scenario_sketches()
    picture = ET.fromstring(picture_svg(sketches))  # noqa: S314 - our own text
    _, _, width, height = (float(number) for number in picture.attrib["viewBox"].split())
    cells = [element for element in picture if element.tag.endswith("}g")]
    assert len(cells) == len(sketches)
    for cell in cells:
        left, top = (float(number) for number in cell.attrib["transform"][len("translate(") : -1].split())
        (line, *_) = (element for element in cell if element.tag.endswith("polyline"))
        points = [[float(number) for number in point.split(",")] for point in line.attrib["points"].split()]
        assert all(0.0 <= left + x <= width and 0.0 <= top + y <= height for x, y in points)
