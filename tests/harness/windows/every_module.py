"""Imports every module of ours, in a process that finds what Windows has; prints those that it cannot, as JSON."""

from __future__ import annotations

import importlib
import json
import pkgutil

import gateway
import protocol
import twin

refused = {}
for package in (gateway, protocol, twin):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            importlib.import_module(module.name)
        except ImportError as error:
            refused[module.name] = str(error)
print(json.dumps(refused))
