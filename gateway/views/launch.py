"""The configured views as commands for the supervisor (processes/supervisor.py)."""

from __future__ import annotations

from pathlib import Path

from gateway.access.folder import SecurityFolder
from gateway.access.listeners import check_listener, nearest
from gateway.config import GatewayConfig
from gateway.processes.supervisor import Service
from gateway.views.listen import ACCOUNT, address
from protocol.errors import require

# View: extra, libraries.
NEEDS = {"opcua": ("opcua", "asyncua"), "hmi": ("web", "starlette", "uvicorn", "jinja2", "prometheus_client")}


def views_for(config: GatewayConfig) -> list[Service]:
    """Return the commands that serve the views of `config` on its bus.

    Raises:
        ConfigError: an address is invalid, or a view would be open to the network without protection.
        InstallError: the libraries of a view are not installed.
    """
    z = config.zenoh
    endpoints = z.listen if z.mode == "router" else z.connect
    bus: tuple[str, ...] = ("--connect", nearest(endpoints), "--site", config.site)
    insecure = ("--insecure",) if config.security.insecure else ()
    folder = SecurityFolder(Path(config.security.directory)) if config.security.directory else None
    if folder is not None:
        bus += ("--identity", str(folder.identity_path(ACCOUNT)))
    views: list[Service] = []
    listeners = {"opcua": config.opcua.listen, "hmi": config.hmi.listen, "foxglove": config.foxglove.listen}
    for name, listen in listeners.items():
        if not listen:
            continue
        if name in NEEDS:
            require(*NEEDS[name])
        host, port = address(listen, where=f"--{name} or [{name}] listen:")
        guarded = folder is not None and name in ("opcua", "hmi")
        options: tuple[str, ...] = ("--security", config.security.directory) if guarded else ()
        listener = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        remedy = "Foxglove has no login: use an ssh tunnel" if name == "foxglove" else "Give --security DIR"
        what = f"--{name} {listener}"
        check_listener(host, protected=guarded, insecure=config.security.insecure, what=what, remedy=remedy)
        if name == "hmi" and config.log.enabled:
            options += ("--log-dir", config.log.directory)
        if name == "opcua":
            options += ("--rate", f"{config.opcua.rate_hz:g}", "--history", f"{config.opcua.history_s:g}")
        views.append(Service(name=name, arguments=("--listen", listener, *bus, *options, *insecure)))
    return views
