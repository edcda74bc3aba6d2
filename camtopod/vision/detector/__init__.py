"""The optional detector of people, a model that the operator has put on this machine.

Reading order:

- `detector`: the step of the pipeline; runs inference where something moves or is tracked;
- `trust`: whether the detector is trusted at this camera, and the objects that it then finds;
- `crops`: the part of the image that is given to the model;
- `model`: crop -> boxes, with `layouts` (outputs -> boxes) and `coco` (names of its classes);
- `engines`: onnxruntime or OpenCV, which run the model, with `inputs` (which image it takes) and
  `onnx_header` (what OpenCV does not say about it).
"""
