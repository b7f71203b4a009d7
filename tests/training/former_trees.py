"""Trees as the converter writes them, and as bundles of earlier software hold them."""

from __future__ import annotations

import onnx
import xgboost
from onnx import helper
from onnxmltools.convert import convert_xgboost
from onnxmltools.convert.common.data_types import FloatTensorType

from training.export import INPUT_NAME, OPSET


def former_trees(booster: xgboost.Booster) -> onnx.ModelProto:
    model: onnx.ModelProto = convert_xgboost(
        booster,
        name="roadgrip",
        initial_types=[(INPUT_NAME, FloatTensorType([None, booster.num_features()]))],
        target_opset=OPSET,
    )
    model.opset_import.append(helper.make_opsetid("", OPSET))
    return model
