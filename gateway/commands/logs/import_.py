"""Convert CSV (also .gz) or MATLAB recordings to logs, one MCAP file each.

Name one table and its columns (--map), or a campaign file that describes many.  Channels are t [s], u_c [V], i_c [A],
x [m, up from the sensor] and x_ref [m].  A value is offset + scale * table(raw).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from gateway.record.tables.table_import import ImportReport, import_recording
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.campaign import CHANNELS, KINDS, Campaign, Channel, Column, Columns, Kind, Recording, load
from protocol.checked import checked
from protocol.errors import UsageError
from protocol.files import make_folder


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "file", type=Path, nargs="?", metavar="FILE", help="CSV, CSV.GZ, MAT or PARQUET; not with --campaign"
    )
    parser.add_argument("--campaign", type=Path, help="campaign.toml or its folder: import its recordings")
    parser.add_argument(
        "--only", action="append", metavar="FILE", help="import only this recording of the campaign; repeatable"
    )
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="folder of recordings that are not beside the campaign"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, help="MCAP file; with --campaign a directory")
    parser.add_argument(
        "--map", action="append", default=[], metavar="CHANNEL=COLUMN[,scale=S][,offset=O][,table=R:V;R:V...]",
        help="column of a channel; a channel without --map is searched under its own name",
    )  # fmt: skip
    parser.add_argument("--kind", choices=KINDS, help="default: closed-loop if x_ref is mapped, else free")
    parser.add_argument("--board", help="name in the log; default: the plant's, or 'imported'")
    parser.add_argument("--site", default=DEFAULT_SITE)
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.epilog = (
        "examples:\n"
        "  board51 import run.csv -o run.mcap --map t=t_s --map i_c=i1_A --map x=gap_m,scale=-1,offset=0.02\n"
        '  board51 import run.csv -o run.mcap --map "u_c=duty,table=0:0.043;0.1:0.613;0.2:1.768"\n'
        "  board51 import --campaign rig/campaign.toml -o logs\n"
        "  board51 import exported.csv -o again.mcap    (what `board51 export` wrote of state needs no --map)"
    )


def run(args: argparse.Namespace) -> int:
    """Import and say what to know about the data."""
    if (args.file is None) == (args.campaign is None):
        raise UsageError("Neither or both of FILE and --campaign are given", remedy="Give one of the two")
    reports = list(_import_campaign(args) if args.campaign else _import_file(args))
    warnings = [f"{report.source}: {warning}" for report in reports for warning in report.warnings]
    for warning in warnings:
        print(f"! {warning}", file=sys.stderr)
    if args.json:
        print(json.dumps([asdict(report) for report in reports], indent=2, default=str))
    else:
        print("\n".join(_as_text(report) for report in reports))
    return 0


def _import_file(args: argparse.Namespace) -> Iterator[ImportReport]:
    columns = dict(_parse_map(spec) for spec in args.map)
    kind: Kind = args.kind or ("closed-loop" if "x_ref" in columns else "free")
    recording = Recording(file=str(args.file), kind=kind, use="fit", columns=columns)
    board = check_name(args.board or "imported", what="--board")
    yield import_recording(args.file, args.out, recording, site=check_name(args.site, what="--site"), board=board)


def _import_campaign(args: argparse.Namespace) -> Iterator[ImportReport]:
    campaign = load(args.campaign)
    if args.map or args.kind:
        raise UsageError("--map and --kind do not go with --campaign", remedy="Write them into the campaign file")
    chosen = [recording for recording in campaign.recordings if not args.only or _matches(recording, args.only)]
    for name in args.only or ():
        if not any(_matches(recording, [name]) for recording in campaign.recordings):
            files = ", ".join(recording.file for recording in campaign.recordings)
            raise UsageError(f"--only {name}: {campaign.where} has no such recording", remedy=f"It has: {files}")
    board = check_name(args.board, what="--board") if args.board else _name_of(campaign)
    site = check_name(args.site, what="--site")
    tables = [recording for recording in chosen if not recording.file.endswith(".mcap")]
    sources = [campaign.path_of(recording, data=args.data) for recording in tables]  # all are there, or none begins
    single = args.out.suffix == ".mcap"
    if single and len(tables) != 1:
        problem = f"-o {args.out} is one file, but there are {len(tables)} recordings"
        raise UsageError(problem, remedy="Give a directory, or use --only")
    if not single:
        make_folder(args.out)
    for number, (recording, source) in enumerate(zip(tables, sources, strict=True), 1):
        if len(tables) > 1 and not args.json:
            print(f"[{number}/{len(tables)}] {recording.file}", file=sys.stderr)
        log = args.out if single else args.out / (re.sub(r"\.(csv|csv\.gz|mat|parquet)$", "", source.name) + ".mcap")
        yield import_recording(source, log, recording, site=site, board=board, campaign=campaign)


def _matches(recording: Recording, names: list[str]) -> bool:
    return recording.file in names or Path(recording.file).name in names


def _name_of(campaign: Campaign) -> str:
    name = re.sub(r"[^a-z0-9_-]+", "-", campaign.plant.name.lower()).strip("-")[:32]
    return check_name(name or "imported", what="plant.name")


def _parse_map(spec: str) -> tuple[Channel, Column]:
    """`x=gap_m,scale=-1,offset=0.02` as the campaign's column."""
    remedy = "Write CHANNEL=COLUMN, and after it scale=, offset= or table=0:0.04;0.1:0.6"
    name, _, rest = spec.partition("=")
    channel = next((known for known in CHANNELS if known == name), None)
    if channel is None:
        raise UsageError(f"--map {spec}: {name!r} is not one of {', '.join(CHANNELS)}", remedy=remedy)
    column, *options = rest.split(",")
    values: dict[str, object] = {"column": column}
    for option in options:
        key, _, value = option.partition("=")
        try:
            if key == "table":
                values[key] = [[float(number) for number in pair.split(":")] for pair in value.split(";")]
            else:
                values[key] = float(value)
        except ValueError:
            raise UsageError(f"--map {spec}: {option!r} is not a number", remedy=remedy) from None
    return channel, checked(Columns, {channel: values}, where="--map")[channel]


def _as_text(report: ImportReport) -> str:
    lines = [f"{report.log}: {report.rows} rows of {', '.join(report.channels)} as board {report.board}"]
    if report.sample_time_s:
        lines.append(f"  T_s {report.sample_time_s * 1e3:g} ms, {report.duration_s:.3f} s")
    if report.gaps:
        lines.append(f"  {report.gaps} gap(s), {report.samples_missing} sample(s) missing")
    if report.irregular_steps:
        lines.append(
            f"  irregular: {report.irregular_steps} step(s) off by more than a tenth of T_s, "
            f"the worst is {report.worst_step_s * 1e3:g} ms"
        )
    for channel, count in report.beyond_table.items():
        lines.append(f"  {channel}: {count} value(s) beyond the look-up table, extrapolated")
    return "\n".join(lines)
