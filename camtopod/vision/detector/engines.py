"""Engines that run an ONNX model: onnxruntime where it is installed, else OpenCV."""

from __future__ import annotations

import logging
import re
from typing import Any, Protocol

import cv2
import numpy as np

from camtopod.vision.boxes import Size
from camtopod.vision.detector.errors import DetectorError
from camtopod.vision.detector.inputs import recognise_inputs
from camtopod.vision.detector.layouts import Outputs
from camtopod.vision.detector.onnx_header import read_header

log = logging.getLogger(__name__)

PROVIDERS_UNUSED = ("TensorrtExecutionProvider", "AzureExecutionProvider")
"""Providers of onnxruntime that are left out.

TensorRT compiles a model for minutes at each start; Azure sends images to a service.
"""
THREADS = 1
"""Threads of an inference on the processor, as with OpenCV; each camera has a process."""
LOG_SEVERITY_MIN = 3
"""Least severity of onnxruntime's own messages on standard error; 3: errors."""
INPUT_TYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}
"""Types of a model's inputs, by the name that onnxruntime has for them."""
_PLACE = r"^\[ONNXRuntimeError\] : \d+ : \w+ : (Load model from .* failed:)?"
"""Beginning of onnxruntime's messages: the number of the error, and the file."""


class Engine(Protocol):
    """A loaded model. For a single thread."""

    size: Size
    """Width and height of its input, pixels."""

    @property
    def name(self) -> str:
        """Name, with the provider if there is a choice of them."""

    def run(self, blob: cv2.typing.MatLike) -> Outputs:
        """Return the outputs for an image as a blob (1, 3, height, width), float32.

        Raises `DetectorError`.
        """


def load_engine(path: str) -> Engine:
    """Return an engine with the model of an ONNX file. Raises `DetectorError`."""
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise DetectorError("model", f"cannot read {path}: {error.strerror}") from None
    try:
        import onnxruntime
    except ImportError:
        return OpenCvEngine(path)
    return OnnxRuntimeEngine(path, onnxruntime)


class OpenCvEngine:
    """A model on OpenCV's DNN."""

    name = "OpenCV"

    def __init__(self, path: str) -> None:
        """Load the model of an ONNX file. Raises `DetectorError`."""
        self._path = path
        self._inputs, in_order = read_header(path)
        self.size = self._inputs.size
        try:
            if in_order is None:
                self._net = cv2.dnn.readNetFromONNX(path)
            else:
                self._net = cv2.dnn.readNetFromONNX(np.frombuffer(in_order, np.uint8))
            self._outputs = self._net.getUnconnectedOutLayersNames()
        except cv2.error as error:
            raise _opencv_error(path, error) from None

    def run(self, blob: cv2.typing.MatLike) -> Outputs:
        """Return the outputs for an image as a blob (1, 3, height, width), float32."""
        try:
            self._net.setInput(blob, self._inputs.image)
            if self._inputs.target:
                self._net.setInput(np.array([self.size], np.int64), self._inputs.target)
            outputs = self._net.forward(self._outputs)
        except cv2.error as error:
            raise _opencv_error(self._path, error) from None
        return {
            name: np.asarray(output, np.float32)
            for name, output in zip(self._outputs, outputs, strict=True)
        }


class OnnxRuntimeEngine:
    """A model on onnxruntime, on the first of its providers that can run it."""

    def __init__(self, path: str, runtime: Any) -> None:
        """Load the model of an ONNX file. Raises `DetectorError`.

        runtime: the module ``onnxruntime``, of any of its wheels.
        """
        self._path = path
        self._runtime = runtime
        self._errors = _errors(runtime)
        self._options = runtime.SessionOptions()
        self._options.intra_op_num_threads = THREADS
        self._options.log_severity_level = LOG_SEVERITY_MIN
        self._providers = [
            name for name in runtime.get_available_providers() if name not in PROVIDERS_UNUSED
        ]
        self._session = self._opened()

        # Its inputs and outputs.
        shapes, self._types = {}, {}
        for value in self._session.get_inputs():
            shapes[value.name] = [n if isinstance(n, int) else 0 for n in value.shape]
            if value.type not in INPUT_TYPES:
                raise DetectorError("model", f"{path} has an input of type {value.type}")
            self._types[value.name] = INPUT_TYPES[value.type]
        self._inputs = recognise_inputs(path, shapes)
        self.size = self._inputs.size
        self._outputs = [value.name for value in self._session.get_outputs()]

    @property
    def name(self) -> str:
        """Name and provider."""
        return f"onnxruntime ({self._providers[0]})"

    def run(self, blob: cv2.typing.MatLike) -> Outputs:
        """Return the outputs for an image as a blob (1, 3, height, width), float32.

        A provider that fails is left for the next, with a warning.
        """
        feed = {self._inputs.image: blob}
        if self._inputs.target:
            feed[self._inputs.target] = np.array([self.size])
        feed = {name: np.asarray(value, self._types[name]) for name, value in feed.items()}
        while True:
            try:
                outputs = self._session.run(self._outputs, feed)
            except self._errors as error:
                self._leave_provider(error, "can be run by onnxruntime no longer")
                self._session = self._opened()
            else:
                return {
                    name: np.asarray(output, np.float32)
                    for name, output in zip(self._outputs, outputs, strict=True)
                }

    def _opened(self) -> Any:
        """Return a session on the first provider that can load the model."""
        while True:
            try:
                session = self._runtime.InferenceSession(
                    self._path, self._options, providers=self._providers, enable_fallback=False
                )
            except self._errors as error:
                self._leave_provider(error)
                continue
            # Providers whose libraries are missing are left out of a session without an error.
            providers = session.get_providers()
            while self._providers[0] not in providers:
                self._leave_provider("it cannot be loaded")
            return session

    def _leave_provider(
        self, reason: Exception | str, fault: str = "is not an ONNX model that onnxruntime can run"
    ) -> None:
        """Go on with the next provider. Raises `DetectorError` with the fault if there is none."""
        words = re.sub(_PLACE, "", " ".join(str(reason).split())).rstrip(".")
        if len(self._providers) < 2:
            raise DetectorError("model", f"{self._path} {fault}: {words}")
        provider = self._providers.pop(0)
        log.warning(
            "detector: %s of onnxruntime fails (%s); %s is used",
            provider,
            words,
            self._providers[0],
        )


def _errors(runtime: Any) -> tuple[type[Exception], ...]:
    """Return the exceptions of onnxruntime's sessions, which have no base of their own."""
    members = vars(runtime.capi.onnxruntime_pybind11_state).values()
    own = [kind for kind in members if isinstance(kind, type) and issubclass(kind, Exception)]
    return (RuntimeError, ValueError, *own)


def _opencv_error(path: str, error: cv2.error) -> DetectorError:
    """Return an error of OpenCV as a sentence, without its place in the source code."""
    words = re.sub(r".*error: \([^)]*\) | in function .*", "", " ".join(str(error).split()))
    return DetectorError("model", f"OpenCV cannot run {path}: {words}")
