from __future__ import annotations

import numpy as np
import pytest

from tests.harness.twin.plain_python import compiled_and_plain

_FILTER = """
import json
import numpy as np
from tests.harness.diagnose.simulated_rig import THETA, criterion_of, narrow, strong
criterion = criterion_of(narrow(THETA, seconds=0.4))
models = THETA, strong("eddy-current-lag", 1e-3), strong("coulomb-friction", 1e-3)
print(json.dumps([np.nan_to_num(criterion.outputs(model), nan=-1.0).tolist() for model in models]))
"""


@pytest.mark.slow
def test_the_filter_gives_the_same_numbers_compiled_and_as_plain_python() -> None:
    """The same file without numba is the oracle; exp and the order of operations may differ in the last digits."""
    compiled, plain = compiled_and_plain(_FILTER)

    assert np.shape(compiled)[0] == 3
    assert np.allclose(compiled, plain, rtol=1e-6, atol=1e-13)
