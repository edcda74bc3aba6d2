"""The learner's input: events put in order of time, and the sliding window of those that count.

Reading order: `reorder_buffer` receives events in any order, drops duplicates and late events, and
releases the others in order of time once the watermark has passed them. `sliding_window` stores
the released events by column (`Window`): it ties the entry and the exit of each track to a passage,
and removes events that are too old or too many.
"""

from camtopod.learn.window.reorder_buffer import (
    ReorderBuffer as ReorderBuffer,
    ReorderBufferState as ReorderBufferState,
)
from camtopod.learn.window.sliding_window import (
    NONE as NONE,
    Window as Window,
    WindowState as WindowState,
)
