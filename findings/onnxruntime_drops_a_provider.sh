#!/bin/sh
# One would guess: a provider that get_available_providers() names can be used; if it cannot,
# making a session with it raises, above all with enable_fallback=False, whichever provider it is.
# What happens: the wheel for GPUs names the providers it was built with, whether or not their
# libraries are there. A session asked for CUDA without libraries of CUDA is made on the
# processor: a line of log, no exception, and fallback switched off changes nothing. Asked for
# TensorRT it raises. So a detector that catches errors to go on with the next provider needs to
# look at the session as well.
# Version: onnxruntime-gpu==1.31.1, model by onnx==1.23.2. Exits with 77 where libnvinfer or
# libcublasLt is installed, as a provider may then be loaded.
# Seen: both are named; CUDA: session with CPUExecutionProvider alone; TensorRT: RuntimeError.
# camtopod: catches the one, compares the session's providers with those it asked for because of
# the other, and warns (camtopod/vision/detector/engines.py).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  onnxruntime-gpu==1.31.1 onnx==1.23.2 numpy==2.4.6
cat > "$folder/run.py" <<'PYTHON'
import ctypes.util
import sys

import numpy as np
import onnxruntime
from onnx import TensorProto, checker, helper

if any(map(ctypes.util.find_library, ("nvinfer", "cublasLt"))):
    print("libraries of TensorRT or CUDA are installed here")
    sys.exit(77)
place, result = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [2]) for name in "xy")
graph = helper.make_graph([helper.make_node("Add", ["x", "x"], ["y"])], "double", [place], [result])
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)


def answer(provider):
    """Return the providers of a session that is asked for one, or the name of the error."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # a line says which library was not found
    try:
        session = onnxruntime.InferenceSession(
            model.SerializeToString(),
            options,
            providers=[provider, "CPUExecutionProvider"],
            enable_fallback=False,
        )
    except RuntimeError as error:
        return type(error).__name__
    [sums] = session.run(["y"], {"x": np.array([1, 2], np.float32)})
    assert sums.tolist() == [2.0, 4.0]
    return session.get_providers()


outcome = {
    provider: (provider in onnxruntime.get_available_providers(), answer(provider))
    for provider in ("CUDAExecutionProvider", "TensorrtExecutionProvider")
}
print(f"onnxruntime {onnxruntime.__version__}: (named, answer) {outcome}")
expectation = {
    "CUDAExecutionProvider": (True, ["CPUExecutionProvider"]),
    "TensorrtExecutionProvider": (True, "RuntimeError"),
}
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
