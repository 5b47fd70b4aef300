"""The formats of `board51 export-model`, and the files of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from protocol.files import make_folder, writing
from twin.export.controller import Controller
from twin.export.fmu.pack import fmu
from twin.export.script.content import Content, content
from twin.export.script.latex import latex
from twin.export.script.matlab import matlab
from twin.export.script.modelica import modelica
from twin.export.script.python import python
from twin.model.parameters import Model
from twin.model.simulate import left_out

Format = Literal["fmu", "matlab", "python", "latex", "modelica"]
FmiVersion = Literal["2.0", "3.0"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """An exported model."""

    files: Mapping[str, bytes]  # by name; one file for an FMU
    notes: tuple[str, ...]  # sentences on what is left out

    def save(self, path: Path | str) -> list[Path]:
        """Write one file to `path`, or several into the folder `path`; returns where they are.

        Raises:
            UsageError: a file cannot be written.
        """
        target = Path(path)
        if len(self.files) == 1:
            placed = dict.fromkeys([target], next(iter(self.files.values())))
        else:
            make_folder(target)
            placed = {target / name: data for name, data in self.files.items()}
        for file, data in placed.items():
            with writing(file):
                file.write_bytes(data)
        return list(placed)


def export(
    model: Model, controller: Controller, to: Format, *, fmi: FmiVersion = "2.0", compiler: str | None = None
) -> Exported:
    """Export a model with the law of its closed loop; formats and errors as in `twin.export_model`."""
    if to == "fmu":
        made = fmu(model, controller.numbers, fmi=fmi, compiler=compiler)
        note = () if made.platform else ("no C compiler was found: the FMU has sources, and no binary",)
        return Exported(files={f"{made.identifier}.fmu": made.content}, notes=(*left_out(model), *note))
    parts = content(model, controller)
    texts = _WRITERS[to](parts)
    missing = [
        f"the differential equation is left out. {why}" for why in parts.without_rates if to in ("matlab", "python")
    ]
    return Exported(files={name: text.encode() for name, text in texts.items()}, notes=(*parts.notes, *missing))


_WRITERS: dict[str, Callable[[Content], Mapping[str, str]]] = {
    "matlab": matlab,
    "python": python,
    "latex": latex,
    "modelica": modelica,
}
