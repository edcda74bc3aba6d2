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
"""Numbers from 1 to 90 that COCO's own numbering leaves out; models with 91 classes use it."""


def class_number(label: str | int, classes: int | None) -> int:
    """Return the number of the class that ``label`` means in the outputs of a model.

    label: a name of `LABELS`, or the number itself.
    classes: how many classes the model has; None if its outputs do not say.

    A model with a single class has no need of names: "person" is that class, whatever it is. Raises
    `DetectorError` if the label cannot be a class of this model.
    """
    if isinstance(label, int):
        if classes is not None and label >= classes:
            raise DetectorError(
                "labels", f"the model has no class {label}: they are 0 to {classes - 1}"
            )
        return label
    names = _names(classes)
    if label not in names:
        raise DetectorError(
            "labels",
            f"the model has {classes} classes, which are not COCO's {len(LABELS)}: "
            f"write the number of the class instead of {label!r}",
        )
    return names.index(label)


def label_name(number: int, classes: int | None) -> str:
    """Return the name of a class number; the number itself if it has none."""
    names = _names(classes)
    return (names[number : number + 1] or [""])[0] or str(number)


def _names(classes: int | None) -> list[str]:
    """Return the names of a model's classes, in their order; "" for one without a name."""
    if classes == 1:
        return ["person"]
    if classes == len(LABELS) + len(GAPS) + 1:
        labels = iter(LABELS)
        return ["" if number in (0, *GAPS) else next(labels) for number in range(classes)]
    return list(LABELS) if classes in (None, len(LABELS)) else []
