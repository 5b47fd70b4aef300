"""The number of examples that are drawn of a costly property: all in the gate, a third in `make test`.

A property is costly where its test takes more than half a second of processor time.  Cheap ones always take all.
"""

from __future__ import annotations

import os

QUICK = "BOARD51_TESTS_QUICK"  # set by conftest.py where slow tests are left out


def costly(examples: int) -> int:
    """The number of examples to draw, of `examples` in the gate."""
    return examples // 3 if os.environ.get(QUICK) else examples
