"""The optional detector of people, a model that the operator has put on this machine.

Motion chooses the crops for inference and dates entries and exits; the detector counts the people
in them. Reading order:

- `detector`: the step of the pipeline; decides when to run inference and
  whether the detector is trusted at this camera;
- `crops`: the parts of the image that are given to the model;
- `model`: the model on OpenCV's DNN, with `onnx_header` (size of its input), `layouts` (its outputs
  -> boxes) and `coco` (names of its classes);
- `fusion`: motion and detections -> the blobs that are tracked.
"""
