"""The optional detector of people, a model that the operator has put on this machine.

Reading order:

- `detector`: the step of the pipeline; runs inference where something moves or is tracked;
- `trust`: whether the detector is trusted at this camera, and the objects that it then finds;
- `crops`: the part of the image that is given to the model;
- `model`: the model on OpenCV's DNN, with `onnx_header` (size of its input), `layouts` (its outputs
  -> boxes) and `coco` (names of its classes).
"""
