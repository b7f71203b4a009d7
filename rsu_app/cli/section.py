"""The command `roadgrip-rsu section`: make maps from surveyed roads, look at them, list those that come along."""

from __future__ import annotations

import json
import re
from math import degrees
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from roadgrip.errors import SectionError
from roadgrip.protocol import HEADER_BYTES
from roadgrip.section import BANK_CAP_RATIO, Direction, RoadSection
from roadgrip.section_file import section_to_json
from roadgrip.sections import packaged_names, read_section
from roadgrip.survey_fit import FitReport, ImportRequest, section_of_survey
from roadgrip.units import mps_to_kph
from rsu_app.cli.section_report import curvature_sketch, curves_of, map_message_problem, plan_sketch, section_figures
from rsu_app.road_import.reading import BYTES_LIMIT, RoadFormat, survey_of_bytes

section_app = typer.Typer(
    help="Make and look at maps: the sections a unit serves.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

PLOT_ENDINGS = (".png", ".svg", ".pdf")
Place = Annotated[
    str,
    typer.Argument(metavar="FILE|NAME", help="A section file (`.json`), or the name of a packaged one: `long-turn`."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")]


@section_app.command("import")
def import_section(
    *,
    source: Annotated[Path, typer.Argument(metavar="FILE", help="NVDB JSON, GeoJSON, WKT or CSV.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The section file to write.")],
    section_id: Annotated[
        str | None, typer.Option("--id", help="Lower-case letters, digits, hyphens; left out, made from the file name.")
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="What people call it; left out, the id.")] = None,
    speed_limit_kmh: Annotated[
        float | None, typer.Option("--speed-limit", metavar="KMH", help="Needed where the source knows none (or 0).")
    ] = None,
    road_format: Annotated[RoadFormat, typer.Option("--format", help="How FILE is written.")] = RoadFormat.AUTO,
    crs: Annotated[
        str | None,
        typer.Option(help="Coordinate reference, `EPSG:25833` or `local`; wins over what FILE says."),
    ] = None,
    direction: Annotated[
        Direction, typer.Option(help="Direction of travel by the road register; `against` drives the line backwards.")
    ] = Direction.WITH,
    reverse: Annotated[bool, typer.Option("--reverse", help="FILE's line runs against the register's metres.")] = False,
    from_m: Annotated[float, typer.Option("--from", metavar="M", help="Begin here, along the travel.")] = 0.0,
    to_m: Annotated[float | None, typer.Option("--to", metavar="M", help="End here; left out, at the end.")] = None,
    smoothing_m: Annotated[
        float | None,
        typer.Option(
            "--smoothing-m",
            metavar="M",
            help="Standard deviation of the smoothing along the line; left out, 3 to 10 m by the spacing of points.",
        ),
    ] = None,
    bank_cap: Annotated[
        float, typer.Option("--bank-cap", metavar="RATIO", help="Largest bank that is believed; 0.08 is 8 %.")
    ] = BANK_CAP_RATIO,
    force: Annotated[bool, typer.Option("--force", help="Replace OUTPUT if it is there.")] = False,
    as_json: AsJson = False,
) -> None:
    r"""Make a section from a surveyed road.

    The line is smoothed and resampled, and how far the result lies from the survey is said. A bank that the source
    does not know is inferred from curvature and speed limit, and marked so: advice never counts on it.

    **Examples**

    A road register's answer, 400 m of it, driven backwards:

        roadgrip-rsu section import nvdb.json --id fv27-bend --speed-limit 80 --from 120 --to 520 \
            --direction against -o fv27-bend.json

    A drawing from a map tool (GeoJSON in degrees):

        roadgrip-rsu section import drawing.geojson --speed-limit 60 -o bend.json

    A table with the columns east_utm33, north_utm33, height, speed_limit_kmh:

        roadgrip-rsu section import survey.csv -o survey.json
    """
    if output.exists() and not force:
        raise SectionError(f"{output} is there already; --force replaces it")
    try:
        if source.stat().st_size > BYTES_LIMIT:
            raise SectionError(f"{source} is larger than {BYTES_LIMIT} bytes; that is no section of road")
        data = source.read_bytes()
    except OSError as error:
        raise SectionError(f"cannot read {source}: {error.strerror or error}") from error
    section_id = section_id or _id_of(source)
    section, report = section_of_survey(
        survey_of_bytes(data, road_format=road_format, crs=crs),
        ImportRequest(
            section_id=section_id,
            name=name or section_id,
            speed_limit_kph=speed_limit_kmh,
            direction=direction,
            reverse=reverse,
            from_m=from_m,
            to_m=to_m,
            smoothing_m=smoothing_m,
            bank_cap_ratio=bank_cap,
        ),
    )
    problem = map_message_problem(section)
    if problem is not None:
        raise SectionError(f"vehicles could not be sent this section ({problem}); cut it with --from and --to")
    _write(output, section_to_json(section))
    if as_json:
        typer.echo(json.dumps({"file": str(output), **section_figures(section), "fit": _fit_figures(report)}, indent=1))
        return
    _print_section(section)
    _print_fit(report, section)
    typer.echo(f"written: {output}")


@section_app.command("show")
def show_section(
    *,
    place: Place,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="OUT.png|svg|pdf", help="Draw plan and profiles into this file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show length, curves with their radii, bank, road difficulty, grade, size on the air, and a sketch.

    **Examples**

        roadgrip-rsu section show long-turn

        roadgrip-rsu section show bend.json --plot bend.png

        roadgrip-rsu section show s-turn --json
    """
    section = read_section(place)
    if plot is not None:
        _draw(section, plot)
    if as_json:
        typer.echo(json.dumps(section_figures(section), indent=1))
    else:
        _print_section(section)
        typer.echo("plan, north up, S start, E end")
        typer.echo(plan_sketch(section))
        typer.echo("curvature over the station")
        typer.echo(curvature_sketch(section))
        if plot is not None:
            typer.echo(f"drawn: {plot}")


@section_app.command("list")
def list_sections(*, as_json: AsJson = False) -> None:
    """List the sections that come along: the roads of the paper, rebuilt."""
    sections = [read_section(name) for name in packaged_names()]
    if as_json:
        typer.echo(json.dumps([section_figures(section) for section in sections], indent=1))
        return
    table = Table("name", "length", "tightest radius", "speed limit", "version")
    for s in sections:
        limit = f"{mps_to_kph(s.speed_limit_mps):.0f} km/h"
        table.add_row(s.section_id, f"{s.length_m:.0f} m", f"{s.tightest_radius_m:.0f} m", limit, s.version)
    Console().print(table)


def _id_of(source: Path) -> str:
    words = re.sub(r"[^a-z0-9]+", "-", source.name.partition(".")[0].lower()).strip("-")[:48].strip("-")
    if not words:
        raise SectionError(f"no id can be made from {source.name!r}; give --id")
    return words


def _write(path: Path, text: str) -> None:
    """Write a file so that nobody ever reads half of it."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise SectionError(f"cannot write {path}: {error.strerror or error}") from error


def _draw(section: RoadSection, path: Path) -> None:
    from rsu_app.cli.section_plot import FIGURE_INCHES, draw_section

    if path.suffix.lower() not in PLOT_ENDINGS:
        raise SectionError(f"{path}: a plot ends in {', '.join(PLOT_ENDINGS)}")
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SectionError("drawing needs matplotlib, which a unit does not carry: pip install matplotlib") from error
    figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
    draw_section(figure, section)
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise SectionError(f"cannot write {path}: {error.strerror or error}") from error


def _print_section(section: RoadSection) -> None:
    figures = section_figures(section)
    table = Table(show_header=False, box=None, pad_edge=False)
    for label, value in (
        ("section", f"{section.name} ({section.section_id}), version {section.version}"),
        ("length", f"{figures['length_m']:.1f} m, {figures['nodes_count']} nodes, {figures['anchors_count']} anchors"),
        ("reference", f"{section.crs}, driven {section.direction.value} the register's direction"),
        ("speed limit", f"{mps_to_kph(section.speed_limit_mps):.0f} km/h"),
        ("tightest radius", f"{figures['tightest_radius_m']:.1f} m, {_g_at_limit(figures)} g at the limit"),
        (
            "bank",
            f"up to {figures['bank_max_ratio']:.1%}, {section.bank_origin.value}, cap {section.bank_cap_ratio:.0%}",
        ),
        ("ideal bank", f"up to {figures['ideal_bank_max_ratio']:.1%}, uncapped"),
        ("road difficulty", f"up to {figures['road_difficulty_max_ratio']:.3f}"),
        (
            "grade",
            f"{figures['grade_min_ratio']:+.1%} to {figures['grade_max_ratio']:+.1%}, rises {figures['rise_m']:.1f} m",
        ),
        ("on the air", _on_the_air(figures)),
    ):
        table.add_row(label, value)
    console = Console(highlight=False)
    console.print(table)
    curves = Table("curve from", "length", "tightest", "mean radius", "turns", "bank", "ideal bank")
    for c in curves_of(section):
        curves.add_row(
            f"{c.start_m:.0f} m",
            f"{c.length_m:.0f} m",
            f"{c.tightest_radius_m:.0f} m",
            f"{c.mean_radius_m:.0f} m",
            f"{abs(degrees(c.turn_rad)):.0f}° {c.direction}",
            f"{c.bank_ratio:.1%}",
            f"{c.ideal_bank_ratio:.1%}",
        )
    console.print(curves)


def _g_at_limit(figures: dict[str, Any]) -> str:
    return f"{figures['lateral_acceleration_at_limit_max_mps2'] / 9.81:.2f}"


def _on_the_air(figures: dict[str, Any]) -> str:
    frames = figures["map_message_frames_count"]
    if frames is None:
        return "cannot be sent: cut the section"
    return f"{figures['map_message_bytes'] + frames * HEADER_BYTES} bytes in {frames} frame(s)"


def _fit_figures(report: FitReport) -> dict[str, Any]:
    return {
        "survey_length_m": round(report.survey_length_m, 1),
        "survey_points_count": report.survey_points_count,
        "deviation_rms_m": round(report.deviation_rms_m, 3),
        "deviation_max_m": round(report.deviation_max_m, 3),
        "smoothing_m": round(report.smoothing_m, 2),
        "node_step_m": round(report.node_step_m, 2),
        "has_heights": report.has_heights,
    }


def _print_fit(report: FitReport, section: RoadSection) -> None:
    typer.echo(
        f"fit: smoothed with {report.smoothing_m:.1f} m; the {report.survey_points_count} surveyed points lie "
        f"{report.deviation_rms_m:.2f} m (rms), at most {report.deviation_max_m:.2f} m from the line"
    )
    if not report.has_heights:
        typer.echo("note: the source has no heights; the section is level")
    if section.bank_origin.value == "inferred":
        typer.echo("note: the source has no bank; it is inferred, and advice will count on none")
