"""The models of a feature table as one ONNX graph, for whoever asks them without a unit: friction, and error to expect.

A bundle keeps them apart, as a unit asks them; a register of models knows one model with its inputs and outputs.
"""

from __future__ import annotations

import onnx
from onnx import compose, helper

MU_OUTPUT_NAME = "mu"
ERROR_OUTPUT_NAME = "expected_error_ratio"


def joined_graph(friction: bytes, error: bytes | None) -> bytes:
    """Return an ONNX model with the input of both, and the outputs `mu` and `expected_error_ratio`, each (n, 1).

    Args:
        friction: The model of friction, as a bundle holds it.
        error: The model of the error to expect, of the same input; None without one.
    """
    parts = [_named(friction, MU_OUTPUT_NAME)]
    if error is not None:
        parts.append(_named(error, ERROR_OUTPUT_NAME))
    opsets = {entry.domain: entry.version for part in parts for entry in part.opset_import}
    graph = helper.make_graph(
        nodes=[node for part in parts for node in part.graph.node],
        name="roadgrip",
        inputs=list(parts[0].graph.input),
        outputs=[output for part in parts for output in part.graph.output],
        initializer=[value for part in parts for value in part.graph.initializer],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid(*entry) for entry in opsets.items()])
    model.ir_version = min(part.ir_version for part in parts)
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def _named(content: bytes, output_name: str) -> onnx.ModelProto:
    """Return a model whose inner names begin with the name of its output, and so meet no other's."""
    model = compose.add_prefix(onnx.load_from_string(content), f"{output_name}/", rename_inputs=False)
    (output,) = model.graph.output
    for node in model.graph.node:
        node.output[:] = [output_name if name == output.name else name for name in node.output]
    output.name = output_name
    return model
