"""Build the release: sdist, wheel, firmware images and bill of materials of the last commit, with sizes and hashes.

The wheel is built from the sdist, so the sdist is complete.  Two builds of a commit with the same lock are equal to
the byte, wherever and by whomever they are made: files of git alone, fixed modes, and the time of the commit.  So are
those of an image with the same compilers, whose versions are printed.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from pathlib import Path

from packaging.metadata import Metadata

ROOT = Path(__file__).resolve().parents[1]
BACKEND = "import sys, setuptools.build_meta as backend; getattr(backend, sys.argv[1])(sys.argv[2])"


def main() -> int:
    """Return 0 when both files are built and their metadata is valid."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the files")
    parser.add_argument("--uncommitted", action="store_true", help="build the tracked files as they are now")
    args = parser.parse_args()
    changed = git("status", "--porcelain", "--untracked-files=no")
    if changed and not args.uncommitted:
        return refuse(f"these files differ from the last commit:\n{changed}\nCommit them, or give --uncommitted.")
    os.umask(0o022)
    os.environ["SOURCE_DATE_EPOCH"] = git("log", "-1", "--format=%ct")
    args.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        built = [*build(Path(folder)), *build_images(Path(folder), dirty=bool(changed)), bill_of(Path(folder))]
        for path in built:
            shutil.copyfile(path, args.out / path.name)
    for path in built:
        content = (args.out / path.name).read_bytes()
        print(f"{hashlib.sha256(content).hexdigest()}  {len(content):>8}  {args.out / path.name}")
    metadata = metadata_of(args.out / built[1].name)
    newest = re.findall("^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)[0]
    if not re.fullmatch(rf"{re.escape(str(metadata.version))} \(\d{{4}}-\d\d-\d\d\)", newest):
        print(f"A draft: CHANGELOG.md begins with '{newest}', not with '{metadata.version} (DATE)'.", file=sys.stderr)
    return 0


def build(folder: Path) -> tuple[Path, Path]:
    """Return sdist and wheel, made in this empty folder."""
    source, made = folder / "source", folder / "made"
    made.mkdir()
    for name in git("ls-files").splitlines():
        target = source / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, target)
        target.chmod(0o755 if os.access(ROOT / name, os.X_OK) else 0o644)
    call_backend("build_sdist", source, made)
    (sdist,) = made.glob("*.tar.gz")
    normalise(sdist)
    with tarfile.open(sdist) as archive:
        # Debian 12 has Python 3.11.2, which knows no filters yet.
        if hasattr(tarfile, "data_filter"):
            archive.extraction_filter = tarfile.data_filter
        archive.extractall(folder)
    call_backend("build_wheel", folder / sdist.name.removesuffix(".tar.gz"), made)
    (wheel,) = made.glob("*.whl")
    return sdist, wheel


def build_images(folder: Path, *, dirty: bool) -> list[Path]:
    """Return the images of the chips, of the sources that `build` has put into this folder; none without compilers."""
    absent = [name for name in ("make", "avr-gcc", "sdcc") if shutil.which(name) is None]
    if absent:
        print(f"Without the firmware's images: {', '.join(absent)} is not installed.", file=sys.stderr)
        return []
    commit = git("rev-parse", "HEAD")
    build_name = f"{commit[:7]}+" if dirty else commit[:8]  # as gateway/emulator/native/build.py
    command = ["make", "-s", f"--directory={folder / 'source' / 'firmware'}", f"OUT={folder / 'images'}"]
    command += [f"BUILD={build_name}", "hashes"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"release: the firmware's images failed:\n{done.stdout}{done.stderr}")
    for compiler in ("avr-gcc", "sdcc"):
        said = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=True).stdout
        print(f"{compiler}: {said.splitlines()[0]}")
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    images = sorted((folder / "images").glob("*.hex"))
    return [image.rename(folder / f"board51-{version}-{image.name}") for image in images]


def bill_of(folder: Path) -> Path:
    """Return the bill of materials of what an installation with all parts brings."""
    from sbom import bill

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    path = folder / f"{project['name']}-{project['version']}.cdx.json"
    path.write_text(bill(ROOT / "requirements-run.lock", name=project["name"], version=project["version"]), "utf-8")
    return path


def normalise(sdist: Path) -> None:
    """Write the archive anew: sorted, without owners, with the time of the commit; setuptools takes those of now."""
    time_s = int(os.environ["SOURCE_DATE_EPOCH"])
    with tarfile.open(sdist) as archive:
        opened = [(one, archive.extractfile(one)) for one in archive.getmembers()]
        content = {one.name: (one.mode, file.read()) for one, file in opened if file is not None}
    with (
        sdist.open("wb") as file,
        gzip.GzipFile("", "wb", fileobj=file, mtime=time_s) as packed,
        tarfile.open(fileobj=packed, mode="w") as archive,
    ):
        for name, (mode, data) in sorted(content.items()):
            member = tarfile.TarInfo(name)
            member.mode, member.mtime, member.size = mode, time_s, len(data)
            archive.addfile(member, io.BytesIO(data))


def call_backend(function: str, source: Path, made: Path) -> None:
    """Call a function of the build backend in the folder of the source."""
    done = subprocess.run(
        [sys.executable, "-c", BACKEND, function, made], cwd=source, capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"release: {function} failed:\n{done.stdout}{done.stderr}")


def metadata_of(wheel: Path) -> Metadata:
    """Return the metadata, every field of which follows the specification.

    Raises:
        ExceptionGroup: some do not.
    """
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return Metadata.from_email(archive.read(name), validate=True)


def git(*words: str) -> str:
    """Return what git says about the clone."""
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.rstrip("\n")


def refuse(reason: str) -> int:
    """Say why nothing is built."""
    print(f"release: {reason}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
