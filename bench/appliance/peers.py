"""What others would serve the same model with: MLServer, BentoML, `mlflow models serve`.

Each is installed into an environment of its own below `build/bench-peers`, which stays until it is deleted, and is
given the packaged friction model, a worker, and what its documentation advises for production. They answer with a
friction and do nothing else: no check, no signature, no second model for the error, no window, no disk.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.http_load import post
from bench.appliance.passages import DEFAULT_BUNDLE, default_manifest
from bench.appliance.processes import running, wait_until
from roadgrip.features import NEWEST_TABLE

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENTS = ROOT / "build" / "bench-peers"
HOST = "127.0.0.1"
START_S = 300.0
INSTALL_S = 900.0
AGREES_WITHIN = 1e-4
BODIES_COUNT = 512
LIBRARIES = ("mlserver", "bentoml", "mlflow", "onnxruntime", "uvicorn", "numpy")

_SESSION = """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession("friction.onnx", options, providers=["CPUExecutionProvider"])
"""
_MLSERVER_RUNTIME = f"""import onnxruntime
from mlserver import MLModel
from mlserver.codecs import NumpyCodec
from mlserver.types import InferenceResponse


def session():{_SESSION}

class Friction(MLModel):
    async def load(self):
        self.session = session()
        self.given = self.session.get_inputs()[0].name
        return True

    async def predict(self, payload):
        rows = NumpyCodec.decode_input(payload.inputs[0])
        answers = self.session.run(None, {{self.given: rows}})[0]
        return InferenceResponse(model_name=self.name, outputs=[NumpyCodec.encode_output("mu", answers)])
"""
_BENTOML_SERVICE = f"""from typing import Annotated

import bentoml
import numpy as np
import onnxruntime
from bentoml.validators import DType, Shape


def session():{_SESSION}
Rows = Annotated[np.ndarray, DType("float32"), Shape((1, {len(NEWEST_TABLE)}))]


@bentoml.service(workers=1, logging={{"access": {{"enabled": False}}}})
class Friction:
    def __init__(self):
        self.session = session()
        self.given = self.session.get_inputs()[0].name

    @bentoml.api
    async def predict(self, rows: Rows) -> np.ndarray:
        return self.session.run(None, {{self.given: rows}})[0]
"""
_MLFLOW_SAVE = """import mlflow.onnx
import onnx

mlflow.onnx.save_model(
    onnx.load("friction.onnx"),
    "model",
    onnx_session_options={
        "intra_op_num_threads": 1,
        "inter_op_num_threads": 1,
        "extra_session_config": {"session.intra_op.allow_spinning": "0"},
    },
)
"""


@dataclass(frozen=True, slots=True)
class Peer:
    """One of them.

    Attributes:
        key: In names of figures and folders.
        name: For people.
        requirements: What is installed.
        setting: How it is set up, for people.
        files: What lies in its folder, by name, besides `friction.onnx`.
        prepare: What runs there once, before it starts; may be nothing.
        command: What starts it, given a port; the first word is a program of its environment.
        health_path: Answers 200 when it is ready.
        path: Where requests go.
        body: Of a request, given a row of features.
        variables: Environment variables.
    """

    key: str
    name: str
    requirements: tuple[str, ...]
    setting: str
    files: Callable[[int], Mapping[str, str]]
    prepare: tuple[str, ...]
    command: Callable[[int], tuple[str, ...]]
    health_path: str
    path: str
    body: Callable[[str], str]
    variables: Mapping[str, str]


PEERS = (
    Peer(
        key="mlserver",
        name="MLServer",
        requirements=("mlserver", "onnxruntime"),
        setting="a custom runtime over onnxruntime that decodes with NumpyCodec; `parallel_workers` 0, so that no "
        "request is handed to another process; `debug` off, so that none is logged; V2 protocol over HTTP",
        files=lambda port: {
            "friction_runtime.py": _MLSERVER_RUNTIME,
            "settings.json": json.dumps(
                {
                    "debug": False,
                    "parallel_workers": 0,
                    "host": HOST,
                    "http_port": port,
                    "grpc_port": free_port(),
                    "metrics_port": free_port(),
                }
            ),
            "model-settings.json": json.dumps({"name": "friction", "implementation": "friction_runtime.Friction"}),
        },
        prepare=(),
        command=lambda _: ("mlserver", "start", "."),
        health_path="/v2/health/ready",
        path="/v2/models/friction/infer",
        body=lambda row: (
            f'{{"inputs":[{{"name":"rows","shape":[1,{len(NEWEST_TABLE)}],"datatype":"FP32","data":[{row}]}}]}}'
        ),
        variables={},
    ),
    Peer(
        key="bentoml",
        name="BentoML",
        requirements=("bentoml", "onnxruntime"),
        setting="a service with one worker whose API is a coroutine, so that no request waits for a thread; access log "
        "off; no batching, which adds a process; JSON",
        files=lambda _: {"service.py": _BENTOML_SERVICE},
        prepare=(),
        command=lambda port: ("bentoml", "serve", "service:Friction", "--host", HOST, "--port", str(port)),
        health_path="/readyz",
        path="/predict",
        body=lambda row: f'{{"rows":[[{row}]]}}',
        variables={"BENTOML_DO_NOT_TRACK": "True"},
    ),
    Peer(
        key="mlflow_serve",
        name="`mlflow models serve`",
        requirements=("mlflow", "onnx", "onnxruntime"),
        setting="the model saved with its onnx flavour; one worker, `--env-manager local`; the `inputs` form of JSON",
        files=lambda _: {"save.py": _MLFLOW_SAVE},
        prepare=("python", "save.py"),
        command=lambda port: (
            *("mlflow", "models", "serve", "--model-uri", "model", "--env-manager", "local", "--workers", "1"),
            *("--host", HOST, "--port", str(port)),
        ),
        health_path="/health",
        path="/invocations",
        body=lambda row: f'{{"inputs":[[{row}]]}}',
        variables={"MLFLOW_DISABLE_TELEMETRY": "true", "DO_NOT_TRACK": "true"},
    ),
)


def installed(peer: Peer) -> Path:
    """Return the folder of programs of a peer's environment, made if it is not there yet.

    Raises:
        RuntimeError: It cannot be installed here; the message says why.
    """
    place = ENVIRONMENTS / peer.key
    done = place / "installed"
    if not done.exists():
        uv = Path(sys.executable).with_name("uv")
        place.mkdir(parents=True, exist_ok=True)
        for words in (
            (uv, "venv", "--quiet", "--clear", "--python", sys.executable, place / "venv"),
            (uv, "pip", "install", "--quiet", "--python", place / "venv" / "bin" / "python", *peer.requirements),
        ):
            try:
                told = subprocess.run(
                    [str(word) for word in words], capture_output=True, text=True, check=False, timeout=INSTALL_S
                )
            except subprocess.TimeoutExpired as error:
                raise RuntimeError(f"{peer.name} was not installed within {INSTALL_S:.0f} s") from error
            if told.returncode:
                raise RuntimeError(f"{peer.name} cannot be installed here\n{told.stderr}")
        done.touch()
    return place / "venv" / "bin"


@dataclass(frozen=True, slots=True)
class RunningPeer:
    """A peer that answers the golden row right.

    Attributes:
        process_id: Of its first process.
        port: Where it listens.
        requests: What it is asked, again and again.
        ready_s: From its start to the first answer that it is ready.
        versions: Of its libraries.
    """

    process_id: int
    port: int
    requests: Sequence[bytes]
    ready_s: float
    versions: Mapping[str, str]


def not_measured(peer: Peer, error: Exception) -> str:
    """Return why a peer could not be measured, for the results; all of it goes to who runs this."""
    print(f"{peer.name}: {error}", file=sys.stderr)
    if isinstance(error, subprocess.SubprocessError):
        return "it could not be prepared"
    # The first line, which names no place of this machine.
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


@contextmanager
def running_peer(peer: Peer, folder: Path) -> Iterator[RunningPeer]:
    """Give a peer that serves the packaged friction model.

    Args:
        peer: Which.
        folder: For its files.

    Raises:
        RuntimeError: It cannot be installed, does not start, or does not answer what the model says.
        OSError, ValueError, subprocess.SubprocessError: The same.
    """
    programs, port = installed(peer), free_port()
    place = folder / peer.key
    place.mkdir()
    (model,) = (model for model in default_manifest().models if model.table_digest == NEWEST_TABLE.digest)
    (place / "friction.onnx").write_bytes((DEFAULT_BUNDLE / model.model_file).read_bytes())
    for name, content in peer.files(port).items():
        (place / name).write_text(content, encoding="utf-8")
    variables = {
        **peer.variables,
        "PATH": f"{programs}:{os.environ['PATH']}",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": str(place),
    }
    if peer.prepare:
        program, *rest = peer.prepare
        with (place / "prepare.log").open("wb") as sink:
            subprocess.run(
                [programs / program, *rest],
                cwd=place,
                env={**os.environ, **variables},
                stdout=sink,
                stderr=subprocess.STDOUT,
                check=True,
                timeout=INSTALL_S,
            )
    requests = _bodies(peer, np.asarray(model.golden.rows, dtype=np.float32))
    log, (program, *rest) = place / "log", peer.command(port)
    began_s = time.perf_counter()
    with running([programs / program, *rest], log=log, environment=variables, cwd=place) as process:
        wait_until(lambda: _answers(port, peer.health_path), process, log=log, limit_s=START_S)
        ready_s = time.perf_counter() - began_s
        _check_answer(peer, port, requests[0], expected_mu=model.golden.mu[0])
        yield RunningPeer(process.pid, port, requests, ready_s, _versions(programs / "python"))


def _bodies(peer: Peer, golden_rows: np.ndarray[Any, np.dtype[np.float32]]) -> list[bytes]:
    """Return requests with rows that differ, the first with the first golden row as it is."""
    ratio = np.linspace(1.0, 1.01, BODIES_COUNT)[:, None]
    rows = golden_rows[np.arange(BODIES_COUNT) % len(golden_rows)] * ratio
    row_format = ",".join(["%.9g"] * rows.shape[1])
    return [
        post(peer.path, peer.body(row_format % tuple(row)).encode(), media_type="application/json")
        for row in rows.astype(np.float32).tolist()
    ]


def _check_answer(peer: Peer, port: int, request: bytes, *, expected_mu: float) -> None:
    """Do nothing if the answer to a golden row is the friction that the laboratory got.

    Raises:
        RuntimeError: It is not: this would not be the same model.
    """
    body = request.partition(b"\r\n\r\n")[2]
    question = urllib.request.Request(
        f"http://{HOST}:{port}{peer.path}", data=body, headers={"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(question, timeout=60.0) as answer:  # noqa: S310 - own server
        told = _numbers(json.loads(answer.read()))
    if not any(abs(value - expected_mu) < AGREES_WITHIN for value in told):
        raise RuntimeError(f"{peer.name} answers {told[:5]}, the model says {expected_mu}")


def _numbers(told: Any) -> list[float]:
    if isinstance(told, Mapping):
        return [number for value in told.values() for number in _numbers(value)]
    if isinstance(told, Sequence) and not isinstance(told, str):
        return [number for value in told for number in _numbers(value)]
    return [float(told)] if isinstance(told, int | float) else []


def _answers(port: int, path: str) -> bool:
    try:
        with urllib.request.urlopen(f"http://{HOST}:{port}{path}", timeout=5.0) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def _versions(python: Path) -> dict[str, str]:
    script = f"""
import json, importlib.metadata as m
print(json.dumps({{d.metadata["Name"]: d.version for d in m.distributions() if d.metadata["Name"] in {LIBRARIES!r}}}))
"""
    told: dict[str, str] = json.loads(subprocess.check_output([python, "-c", script], text=True))
    return told


def free_port() -> int:
    """Return a TCP port of this machine that nobody listens on now."""
    with socket.socket() as link:
        link.bind((HOST, 0))
        return int(link.getsockname()[1])
