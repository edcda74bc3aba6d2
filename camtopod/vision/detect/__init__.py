"""Detection: a frame -> blobs of moving pixels.

In the order of use: `shrink` (working size), `wiener` (noise filter, thesis 4.1), `background`
(model of the settled scene), `shake` (shift of the image), `swaying` (scenery that moves in place),
`object_contrast` (haze), `motion` (moving pixels), `blobs` (boxes with a foot point).
"""

from camtopod.vision.detect.background import Luma as Luma
from camtopod.vision.detect.blobs import (
    FILL_SHARE_MIN as FILL_SHARE_MIN,
    Blob as Blob,
    find_blobs as find_blobs,
)
from camtopod.vision.detect.motion import (
    DIFFERENCE_MIN as DIFFERENCE_MIN,
    Motion as Motion,
    MotionDetector as MotionDetector,
)
from camtopod.vision.detect.shake import moved as moved
from camtopod.vision.detect.shrink import shrunk as shrunk
