"""The laboratory: drives with known friction in, a model bundle the road side unit can trust out."""

import os

# Before anything here imports onnxruntime, which on Linux reports to its maker unless it is told not to.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
