"""The models that ship with the product."""

from __future__ import annotations

from twin.model.parameters import Model


def nominal(name: str = "ce152") -> Model:
    """Load a shipped model: `ce152`, `inteco` (the rig of the public recordings), `magnetoshield`.

    Raises DataError.
    """
    return Model.load(name)
