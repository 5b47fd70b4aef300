"""A model for other tools: the function behind `board51 export-model`."""

from __future__ import annotations

from pathlib import Path

from twin.api.functions import design
from twin.api.results import Designed
from twin.export.controller import of_design, of_file
from twin.export.formats import Exported, FmiVersion, Format, export
from twin.model.parameters import Model


def export_model(
    model: Model | Path | str,
    to: Format,
    *,
    controller: Designed | Path | str | None = None,
    u_max_v: float = 5.0,
    fmi: FmiVersion = "2.0",
    compiler: str | None = None,
) -> Exported:
    """Export a model with its causes and a control law.

    Args:
        model: a model, a model file, or the name of a shipped model.
        to: fmu, matlab, python, latex or modelica.
        controller: the law: the result of `design`, or a controller file; None: `design` for this model.
        u_max_v: upper limit of the input, V.
        fmi: of an FMU: version of FMI.
        compiler: of an FMU: C compiler for its binary; None: gcc, cc or clang; empty: sources only.

    Returns:
        The files, and sentences on what is left out.

    Raises:
        NotTranslatableError: a part of the model has no form in this format; the message says which and why.
        DataError: a file is missing or bad, or K_A or K_c of the model is a placeholder.
        UsageError: there is no such operating point, or the compiler fails.
    """
    loaded = model if isinstance(model, Model) else Model.load(model)
    if controller is None:
        controller = design(loaded, u_max_v=u_max_v)
    if isinstance(controller, Designed):
        law = of_design(controller.details, u_max_v=u_max_v)
    else:
        law = of_file(Path(controller), u_max_v=u_max_v)
    return export(loaded, law, to, fmi=fmi, compiler=compiler)
