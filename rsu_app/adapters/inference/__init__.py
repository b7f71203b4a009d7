"""The door to onnxruntime: models of a bundle that answer."""

import os

# On Linux onnxruntime reports to its maker unless it is told not to before it is imported. A unit beside a road calls
# nobody that its operator has not named.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from rsu_app.adapters.inference.onnx_model import OnnxFrictionModel, load_bundle

__all__ = ["OnnxFrictionModel", "load_bundle"]
