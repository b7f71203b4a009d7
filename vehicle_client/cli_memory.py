"""The command `roadgrip-vehicle memory`: what a car has learned of itself, shown or forgotten."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from roadgrip.errors import ConfigurationError
from vehicle_client.cli_options import AsJson


def memory(
    file: Annotated[Path, typer.Argument(help="The file that `live --memory` or `replay --memory` writes.")],
    vehicle: Annotated[
        Path | None,
        typer.Option(
            "--vehicle", metavar="FILE", help="The car's file: shows what it declares beside what was learned."
        ),
    ] = None,
    forget: Annotated[bool, typer.Option("--forget", help="Remove it, and what was moved aside of it.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what a car has learned of its sensors and tyres, or forget it.

    A file that is no memory of a car is refused and left as it is, and so is the memory of another vehicle than the
    one that `--vehicle` names.
    """
    from rich.console import Console

    from vehicle_client.shell.car_memory import forget_memory, memory_of, read_kept
    from vehicle_client.shell.memory_view import memory_table, memory_to_json
    from vehicle_client.shell.sources import read_vehicle

    car = None if vehicle is None else read_vehicle(vehicle)
    try:
        if car is not None:
            # Says what is wrong with the memory of another vehicle.
            memory_of(file, car)
        if forget:
            was_there = forget_memory(file)
            print(f"{file}: {'forgotten' if was_there else 'there was no memory'}")
            return
        kept = read_kept(file)
    except OSError as error:
        raise ConfigurationError(f"cannot use {file}: {error.strerror or error}") from error
    if kept is None:
        raise ConfigurationError(f"{file} is not there: this car has learned nothing yet")
    if as_json:
        print(json.dumps(memory_to_json(kept, car), indent=1))
    else:
        Console().print(memory_table(kept, car))
