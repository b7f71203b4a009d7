"""Full histories of drives as Parquet, for those who want to look into them: what was sensed beside what was true.

One file per shard, one row per 10 ms and run. They are large, about 10 kB per simulated second. What was sensed has the
columns of a recorded drive (`vehicle_client.recording.channels`), so that whatever reads one reads these; a column
`run_key` says whose row it is.
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
from vehicle_client.estimation.trace import Trace
from vehicle_client.recording.channels import (
    CHANNELS,
    GNSS_COLUMNS,
    GNSS_SPEED_COLUMN,
    STABILITY_COLUMN,
    TIME_COLUMN,
)
from vehicle_client.recording.own_columns import columns_of_trace
from vehicle_client.simulator.drive import Drive, Truth

_EXACT = ("gnss_time_s", "lat_deg", "lon_deg")
"""32 bits would round a position to half a metre."""
_SENSED = (TIME_COLUMN, *CHANNELS, STABILITY_COLUMN, *GNSS_COLUMNS, GNSS_SPEED_COLUMN)
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
                *((name, pa.float64() if name in _EXACT else pa.float32()) for name in _SENSED),
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
    count = len(trace.time_s)
    sensed = columns_of_trace(trace)
    columns: dict[str, FloatArray] = {name: sensed.get(name, np.full(count, np.nan)) for name in _SENSED}
    columns |= {f"true_{name}": getattr(truth, name) for name in _TRUE}
    key = pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, dtype=np.int32)), pa.array([run_key]))
    active = {name: getattr(truth, name) for name in _ACTIVE}
    rounded = {name: values.astype(np.float64 if name in _EXACT else np.float32) for name, values in columns.items()}
    return {"run_key": key, **rounded, **active}
