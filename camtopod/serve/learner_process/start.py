"""How the learner's process begins: without what NumPy would load by the way and nobody here asks
for.

    python -m camtopod.serve.learner_process.start BOARD

SciPy looks at everything that NumPy names, which loads NumPy's test tools and its Fortran front
end: 8 MB. With something else in their places they are not loaded until somebody imports them by
name.
"""

from __future__ import annotations

import numpy as np

SPARED = ("testing", "f2py")


def spare() -> None:
    """To be called before SciPy is imported, in a process that is the learner's alone."""
    for part in SPARED:
        setattr(np, part, None)


def begin() -> None:
    """Learn until the daemon ends; never returns."""
    spare()
    from camtopod.serve.learner_process.worker import main

    main()


if __name__ == "__main__":
    begin()
