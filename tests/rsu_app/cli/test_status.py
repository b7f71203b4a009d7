from __future__ import annotations

import io
import json
import socket

import pytest
from rich.console import Console
from typer.testing import CliRunner

from rsu_app.cli.status import shown, watch
from rsu_app.cli.status_picture import picture
from rsu_app.control_client import ControlError
from tests.rsu_app.cli.statuses import section_said, status_said, troubled


def lines_of(said, *, width_count: int = 80, height_count: int | None = None) -> list[str]:
    return [line.plain for line in picture(said, width_count=width_count, height_count=height_count)]


@pytest.mark.parametrize(("name", "said"), [("well", status_said()), ("troubled", troubled())])
def test_the_picture_in_80_columns_is_the_one_that_was_looked_at(project_root, name, said):
    golden = project_root / "tests" / "rsu_app" / "cli" / "golden" / f"status_{name}.txt"
    assert "\n".join(lines_of(said)) + "\n" == golden.read_text(encoding="utf-8")


@pytest.mark.parametrize("said", [status_said(), troubled(), status_said(sections=[section_said()] * 40)])
@pytest.mark.parametrize(("width_count", "height_count"), [(80, 24), (200, 60)])
def test_the_picture_stays_within_the_terminal(said, width_count, height_count):
    lines = lines_of(said, width_count=width_count, height_count=height_count)
    assert len(lines) <= height_count
    assert max(map(len, lines)) <= width_count


def test_what_was_cut_to_fit_says_how_much_is_missing():
    lines = lines_of(status_said(sections=[section_said(f"bend-{n}") for n in range(40)]), height_count=24)
    (more,) = [line for line in lines if " more" in line]
    assert int(more.split()[1]) + sum(line.startswith("bend-") for line in lines) == 40


def test_a_unit_that_is_unready_tells_its_reasons_first():
    assert [line[:14] for line in lines_of(troubled())[1:3]] == ["needs    NO   ", "         NO   "]


def test_nothing_is_told_by_colour_alone_nor_by_letters_that_a_serial_line_lacks():
    out = io.StringIO()
    console = Console(file=out, width=80, no_color=True)
    console.print(shown(troubled(), console, whole=True))
    assert "\n".join(lines_of(troubled())) + "\n" == out.getvalue()
    assert out.getvalue().isascii()


class Onlooker:
    """Looks as often as there are answers."""

    def __init__(self, *answers: object) -> None:
        self._answers = list(answers)
        self._out = io.StringIO()
        self.console = Console(file=self._out, width=80, height=24, force_terminal=True)

    def pause(self) -> bool:
        return bool(self._answers)

    def ask(self):
        answer = self._answers.pop(0)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def watch(self) -> dict[str, object]:
        return watch(status_said(), self.ask, self.console, pause=self.pause)

    @property
    def saw(self) -> str:
        return self._out.getvalue()


def test_the_live_view_shows_each_answer_and_keeps_the_last():
    onlooker = Onlooker(status_said(), troubled())
    assert onlooker.watch() == troubled()
    assert onlooker.saw.index("NOT READY") > onlooker.saw.index("READY")


@pytest.mark.parametrize("answer", [None, ControlError("the unit does not answer: timed out")])
def test_a_unit_that_falls_silent_is_said_so_above_its_last_answer(answer):
    onlooker = Onlooker(answer)
    assert onlooker.watch() == status_said()
    assert "below is old" in onlooker.saw


def test_the_live_view_ends_with_ctrl_c():
    assert Onlooker(KeyboardInterrupt()).watch() == status_said()


def test_without_a_running_unit_a_machine_is_told_so_too(tmp_path):
    import rsu_app.cli.main as program

    config = tmp_path / "rsu.toml"
    config.write_text('[database]\npath = "rsu.sqlite3"\n')
    result = CliRunner().invoke(program.app, ["status", "--json", "--config", str(config)])
    told = json.loads(result.stdout)
    assert (result.exit_code, told["running"], told["ready"]) == (1, False, False)


def test_a_unit_that_does_not_answer_is_not_waited_for_for_ever(tmp_path):
    from rsu_app.control_client import ask

    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.bind(str(tmp_path / "s"))
        link.listen()
        with pytest.raises(ControlError, match="timed out"):
            ask(tmp_path / "s", "/status", timeout_s=0.05)
