"""The nodes of a rig, in one place: laid out below RigType as instance declarations, and below each rig.

Type and rigs cannot differ: the same code makes both.
"""

from __future__ import annotations

from dataclasses import replace

from asyncua import ua

from gateway.views.opcua.address_space.extras import EXTRAS, LINK_CODE
from gateway.views.opcua.address_space.model import TOPICS, Argument, Leaf, leaves, methods, unit_of
from gateway.views.opcua.address_space.parameters import FIELDS, INSTRUMENTS, RANGED
from gateway.views.opcua.address_space.words import FOLDERS
from gateway.views.opcua.types.build import HISTORY, READ, WRITE, Builder
from protocol.bus import topics

_O, _V = ua.ObjectIds, ua.VariantType
MACHINE_IDENTIFICATION = 1012  # MachineIdentificationType of OPC UA for Machinery
MACHINES = 1001  # its folder of all machines
RIG_TYPE = "RigType"
LINK_STATE = "LinkState"  # our data type of link/code
SETPOINTS = (  # path, field of State, what it is
    ("setpoint/x_ref_m", "x_ref_m", "write: a new reference, through the gateway's limits"),
    ("setpoint/mode", "mode", "write: 0 idle (coil off), 1 open loop, 2 closed loop"),
)
OUTPUTS = (
    Argument(name="accepted", variant=_V.Boolean, is_array=False, description="whether the command was carried out"),
    Argument(name="reason", variant=_V.String, is_array=False, description="kebab-case, stable; empty where accepted"),
    Argument(name="text", variant=_V.String, is_array=False, description="a sentence for people"),
    Argument(name="tick", variant=_V.UInt64, is_array=False, description="from which it is in force"),
)


class Layout:
    """Builds the nodes below one rig, or below the type.

    Args:
        builder: of the namespace of the node ids.
        top: node of the rig or of the type.
        root: its path.
        interval_ms: shortest interval of the values; 0 where it is not known.
    """

    def __init__(self, builder: Builder, top: ua.NodeId, root: str, *, interval_ms: float = 0.0) -> None:
        self._builder, self._root, self._interval_ms = builder, root, interval_ms
        self._places = {"": top}
        for leaf in leaves():
            self._leaf(leaf)
        for extra in EXTRAS:
            data_type = ua.NodeId(LINK_STATE, builder.spaces.types) if extra.path == LINK_CODE else None
            path = f"{root}/{extra.path}"
            builder.variable(self._above(extra.path), path, extra, data_type=data_type, min_sampling_ms=interval_ms)
        for path, field, description in SETPOINTS:
            leaf = next(leaf for leaf in leaves() if leaf.path == f"state/{field}")
            node = builder.variable(
                self._above(path),
                f"{root}/{path}",
                replace(leaf, description=description),
                access=READ | WRITE,
                kind=_kind(leaf, path),
                min_sampling_ms=interval_ms,
            )
            self._describe_value(node, leaf, path)
        for method in methods():
            builder.method(top, f"{root}/{method.name}", method.description, method.arguments, OUTPUTS)
        self._nameplate(top)

    def _above(self, path: str) -> ua.NodeId:
        """Return the folder of a path; make it if it is missing."""
        folder, _, _ = path.rpartition("/")
        if folder not in self._places:
            description = topics.TOPIC_OF_NAME[folder].description if folder in TOPICS else FOLDERS[folder]
            self._places[folder] = self._builder.object(self._above(folder), f"{self._root}/{folder}", description)
        return self._places[folder]

    def _leaf(self, leaf: Leaf) -> None:
        extreme = leaf.statistic in ("low", "high")
        base = leaf.path.rpartition("/")[0]
        node = self._builder.variable(
            self._builder.id(f"{self._root}/{base}") if extreme else self._above(leaf.path),
            f"{self._root}/{leaf.path}",
            leaf,
            access=READ | HISTORY if leaf.statistic is not None else READ,
            kind=_kind(leaf, leaf.path),
            min_sampling_ms=self._interval_ms,
        )
        self._describe_value(node, leaf, leaf.path)

    def _describe_value(self, node: ua.NodeId, leaf: Leaf, path: str) -> None:
        """Add unit, ranges or words; the values of a range come with the board's parameters."""
        path, relative = f"{self._root}/{path}", path
        if leaf.unit is not None:
            self._builder.property(
                node, f"{path}/EngineeringUnits", unit_of(leaf.field), _V.ExtensionObject, _O.EUInformation
            )
            for name, paths in (("EURange", RANGED), ("InstrumentRange", INSTRUMENTS)):
                if relative in paths:
                    self._builder.property(node, f"{path}/{name}", None, _V.ExtensionObject, _O.Range)
        if leaf.words:
            words = [ua.LocalizedText(word) for word in leaf.words]
            self._builder.property(node, f"{path}/EnumStrings", words, _V.LocalizedText, _O.LocalizedText)

    def _nameplate(self, top: ua.NodeId) -> None:
        spaces, path = self._builder.spaces, f"{self._root}/Identification"
        plate = self._builder.object(
            top,
            path,
            FOLDERS["Identification"],
            kind=ua.NodeId(MACHINE_IDENTIFICATION, spaces.machinery),
            reference=_O.HasAddIn,
            name=ua.QualifiedName("Identification", spaces.di),
        )
        for name, (variant, description) in FIELDS.items():
            self._builder.property(
                plate,
                f"{path}/{name}",
                None,
                variant,
                int(variant),
                description=description,
                name=ua.QualifiedName(name, spaces.di),
            )


def _kind(leaf: Leaf, path: str) -> int:
    """Return the type of a variable: AnalogItemType promises an EURange, MultiStateDiscreteType words."""
    if leaf.unit is not None:
        return int(_O.AnalogItemType if path in RANGED else _O.AnalogUnitType)
    return int(_O.MultiStateDiscreteType if leaf.words else _O.BaseDataVariableType)
