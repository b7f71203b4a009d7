"""Full histories of drives as Parquet, for those who want to look into them: what was sensed beside what was true.

One file per shard, one row per 10 ms and run. They are large, about 10 kB per simulated second.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from roadgrip.units import FloatArray
from training.dataset import metadata_of
from training.scenarios import Run
from vehicle_client.estimation.trace import WHEELS, Trace
from vehicle_client.simulator.drive import Drive, Truth

_SENSED = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad")
_TRUE = (
    "station_m",
    "lateral_offset_m",
    "velocity_x_mps",
    "velocity_y_mps",
    "yaw_rate_radps",
    "roll_rad",
    "bank_rad",
    "steer_rad",
    "friction_mu",
    "utilisation_ratio",
)
_ACTIVE = ("abs_active", "tcs_active", "esc_active")


class DriveWriter:
    """Writes the drives of a shard, batch by batch; the file appears when the block ends without an error."""

    def __init__(self, path: Path, *, description: dict[str, str]) -> None:
        self._path = path
        self._partial = path.with_suffix(".partial")
        self._schema = pa.schema(
            [
                ("run_key", pa.dictionary(pa.int32(), pa.string())),
                ("time_s", pa.float32()),
                *((name, pa.float32()) for name in _SENSED),
                *((f"wheel_speed_{wheel}_mps", pa.float32()) for wheel in WHEELS),
                *((f"true_{name}", pa.float32()) for name in _TRUE),
                *((name, pa.bool_()) for name in _ACTIVE),
            ],
            metadata=metadata_of(description),
        )

    def __enter__(self) -> Self:
        """Open the file."""
        self._writer = pq.ParquetWriter(self._partial, self._schema, compression="zstd")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file, and let it appear if all went well."""
        self._writer.close()
        if kind is None:
            self._partial.replace(self._path)
        else:
            self._partial.unlink(missing_ok=True)

    def write(self, runs: Sequence[Run], drives: Sequence[Drive]) -> None:
        """Write some drives, however they ended."""
        for run, drive in zip(runs, drives, strict=True):
            self._writer.write_table(pa.table(_columns(run.key, drive.trace, drive.truth), schema=self._schema))


def _columns(run_key: str, trace: Trace, truth: Truth) -> dict[str, object]:
    columns: dict[str, FloatArray] = {"time_s": trace.time_s}
    columns |= {name: getattr(trace, name) for name in _SENSED}
    columns |= {f"wheel_speed_{wheel}_mps": trace.wheel_speed_mps[:, i] for i, wheel in enumerate(WHEELS)}
    columns |= {f"true_{name}": getattr(truth, name) for name in _TRUE}
    key = pa.DictionaryArray.from_arrays(pa.array(np.zeros(len(trace.time_s), dtype=np.int32)), pa.array([run_key]))
    active = {name: getattr(truth, name) for name in _ACTIVE}
    return {"run_key": key, **{name: values.astype(np.float32) for name, values in columns.items()}, **active}
