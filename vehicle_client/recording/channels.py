"""The names of the columns that a recorded drive has in our own format.

| column | what |
|---|---|
| `time_s` | monotonic clock; 100 rows a second, else the rows are resampled |
| `accel_x_mps2`, `accel_y_mps2` | specific force, forward and left |
| `roll_rate_radps`, `yaw_rate_radps` | left side up, left turn positive |
| `steer_rad` | mean angle of the front wheels, left positive |
| `wheel_front_left_mps` ... `wheel_rear_right_mps` | rotation times rolling radius |
| `stability_active` | optional: 1 while ABS, traction control or ESC intervene, else 0 |
| `gnss_time_s`, `lat_deg`, `lon_deg`, `gnss_accuracy_m` | optional: a position fix, in the row nearest to its time |
| `gnss_speed_mps` | optional: speed over ground of that fix |

Columns may come in any order; unknown ones are ignored. An empty cell in a sensor's column makes the row a missing
sample. `gnss_time_s` may be left out (the row's time is taken), and `gnss_accuracy_m` too (3 m).
"""

from __future__ import annotations

from vehicle_client.estimation.trace import WHEELS

TIME_COLUMN = "time_s"
SENSOR_COLUMNS = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad")
WHEEL_COLUMNS = tuple(f"wheel_{wheel}_mps" for wheel in WHEELS)
CHANNELS = SENSOR_COLUMNS + WHEEL_COLUMNS
"""What every recording must hold, in the order of arrays with one column per channel."""
STABILITY_COLUMN = "stability_active"
GNSS_COLUMNS = ("gnss_time_s", "lat_deg", "lon_deg", "gnss_accuracy_m")
GNSS_SPEED_COLUMN = "gnss_speed_mps"

STABILITY_CHANNELS = ("abs_active", "tcs_active", "esc_active", STABILITY_COLUMN)
"""Flags of a car that speaks for each of its systems; any of them makes a sample `stability_active`."""
FIX_CHANNELS = ("lat_deg", "lon_deg", "gnss_accuracy_m", GNSS_SPEED_COLUMN)
SERIES_CHANNELS = CHANNELS + STABILITY_CHANNELS + FIX_CHANNELS
"""Whatever can come as a series of its own, with its own time stamps."""
