"""Labels of COCO, the classes that nearly all published detectors were trained on.

T.-Y. Lin et al., Microsoft COCO: Common Objects in Context, ECCV 2014.
"""

from __future__ import annotations

from camtopod.vision.detector.errors import DetectorError

_NAMES = (
    "person|bicycle|car|motorcycle|airplane|bus|train|truck|boat|traffic light|fire hydrant|"
    "stop sign|parking meter|bench|bird|cat|dog|horse|sheep|cow|elephant|bear|zebra|giraffe|"
    "backpack|umbrella|handbag|tie|suitcase|frisbee|skis|snowboard|sports ball|kite|baseball bat|"
    "baseball glove|skateboard|surfboard|tennis racket|bottle|wine glass|cup|fork|knife|spoon|bowl|"
    "banana|apple|sandwich|orange|broccoli|carrot|hot dog|pizza|donut|cake|chair|couch|"
    "potted plant|bed|dining table|toilet|tv|laptop|mouse|remote|keyboard|cell phone|microwave|"
    "oven|toaster|sink|refrigerator|book|clock|vase|scissors|teddy bear|hair drier|toothbrush"
)
LABELS = tuple(_NAMES.split("|"))
"""The 80 labels, in the order in which detectors number their classes, from 0."""
GAPS = (12, 26, 29, 30, 45, 66, 68, 69, 71, 83)
"""Numbers from 1 to 90 that COCO's own numbering leaves out."""
IDS = [number for number in range(1, 91) if number not in GAPS]
"""COCO's own number of each of the 80 labels; detectors of the SSD family use it."""


def class_number(label: str | int, classes: int | None, from_one: bool) -> int:
    """Return the number of the class that ``label`` means in the outputs of a model.

    label: a name of `LABELS`, or the number itself.
    classes: how many classes the model has; None if its outputs do not say.
    from_one: True if its numbers are COCO's own, from 1, with gaps.

    A model with a single class has no need of names: "person" is that class, whatever it is. Raises
    `DetectorError` if the label cannot be a class of this model.
    """
    if isinstance(label, int):
        if classes is not None and label >= classes:
            raise DetectorError(
                "labels", f"the model has no class {label}: they are 0 to {classes - 1}"
            )
        return label
    if classes == 1 and label == "person":
        return 0
    if classes not in (None, len(LABELS), 91):
        raise DetectorError(
            "labels",
            f"the model has {classes} classes, which are not COCO's {len(LABELS)}: "
            f"write the number of the class instead of {label!r}",
        )
    index = LABELS.index(label)
    return IDS[index] if from_one or classes == 91 else index


def label_name(number: int, classes: int | None, from_one: bool) -> str:
    """Return the name of a class number; the number itself if it has none."""
    if classes == 1:
        return "person"
    if from_one or classes == 91:
        return LABELS[IDS.index(number)] if number in IDS else str(number)
    return (
        LABELS[number] if classes in (None, len(LABELS)) and number < len(LABELS) else str(number)
    )
