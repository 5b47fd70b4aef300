"""A real S3 server for tests: SeaweedFS, on ports of its own, with one user and one bucket."""

from __future__ import annotations

import json
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from obstore.exceptions import BaseError
from obstore.store import S3Store

from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port

WEED = shutil.which("weed", path=sysconfig.get_path("scripts"))
BUCKET, KEY, SECRET = "plant", "gateway", "a-key-for-tests"
_USERS = {
    "identities": [
        {"name": KEY, "credentials": [{"accessKey": KEY, "secretKey": SECRET}], "actions": ["Admin"]},
        {
            "name": "reader",
            "credentials": [{"accessKey": "reader", "secretKey": SECRET}],
            "actions": [f"Read:{BUCKET}", f"List:{BUCKET}"],
        },
    ]
}
_SERVERS = ("master", "volume", "filer", "s3", "admin")


class S3Server:
    """Starts and kills the server, with the same objects and the same address each time."""

    def __init__(self, folder: Path) -> None:
        assert WEED is not None, "make install has it"
        self._program = WEED
        self._ports = {f"{name}.port{kind}": free_port() for name in _SERVERS for kind in ("", ".grpc")}
        self.endpoint = f"http://127.0.0.1:{self._ports['s3.port']}"
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        (folder / "data").mkdir()
        (folder / "users.json").write_text(json.dumps(_USERS), encoding="utf-8")

    def start(self) -> None:
        ports = [f"-{option}={port}" for option, port in self._ports.items()]
        with (self._folder / "server.txt").open("ab") as log:
            self._process = subprocess.Popen(
                [
                    self._program, "mini", f"-dir={self._folder / 'data'}", "-ip=127.0.0.1", "-ip.bind=127.0.0.1",
                    f"-s3.config={self._folder / 'users.json'}", f"-bucket={BUCKET}", "-s3.autoCreateBucket=false",
                    "-master.telemetry=false", "-webdav=false", "-admin.ui=false", "-s3.port.iceberg=0",
                    "-s3.port.lance=0",
                    *ports,
                ],
                stdout=log, stderr=log,
            )  # fmt: skip
        wait_for(self._is_ready, "the bucket of the S3 server")

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for port in self._ports.values():  # nothing tells it to put these elsewhere
                for left in Path("/tmp").glob(f"seaweedfs-*-{port}.sock"):
                    left.unlink()

    def store(self) -> S3Store:
        """The bucket, as another program sees it."""
        return S3Store(
            BUCKET, endpoint=self.endpoint, access_key_id=KEY, secret_access_key=SECRET,
            client_options={"allow_http": True}, retry_config={"max_retries": 0},
        )  # fmt: skip

    def _is_ready(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, (self._folder / "server.txt").read_text(encoding="utf-8")
        try:
            list(self.store().list())
        except BaseError:
            return False
        return True


@contextmanager
def s3_server() -> Iterator[S3Server]:
    """Run a server, in a folder with a short name: it has sockets there."""
    with tempfile.TemporaryDirectory(prefix="s3-") as folder:
        server = S3Server(Path(folder))
        try:
            server.start()
            yield server
        finally:
            server.kill()
