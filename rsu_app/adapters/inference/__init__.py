"""Running the model of a bundle. The one door to onnxruntime on the road side unit."""

from rsu_app.adapters.inference.onnx_model import OnnxFrictionModel, load_bundle

__all__ = ["OnnxFrictionModel", "load_bundle"]
