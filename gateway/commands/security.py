"""Make keys, certificates, users and the rules of a guarded bus, in one folder.

`init` makes the folder; give it to the gateway (`--security DIR`), to the router, to OPC UA and the web page.  Each
person gets a login for OPC UA and the web page, and an identity folder for `board51 send`, `watch`, ... (`--identity`).
Roles: a viewer reads, an operator moves the ball within the limits, an engineer also changes gains and models.

A program logs in at the web page's API with a token; users.toml keeps only its digest.

Changed users count at once for OPC UA and the web page.  On the bus they count when its router starts again, or the
gateway, if that is the router.
"""

from __future__ import annotations

import argparse
import getpass
import json
import secrets
import sys
from pathlib import Path

from gateway.access.folder import SecurityFolder
from gateway.access.private import open_output, write_private
from gateway.access.roles import ROLE_WORDS, Role, parse_role
from gateway.access.users import User, remove_token, set_token
from protocol.arguments import add_repeatable
from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint, zenoh_config
from protocol.bus.identity import load_identity
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.errors import UsageError

_USER = "NAME:ROLE"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add a sub-command for each step."""
    parser.epilog = (
        "examples:\n"
        "  board51 security init keys --host 10.0.0.5 --user ana:engineer --user ben:operator\n"
        "  board51 gateway --security keys --listen tcp/127.0.0.1:7447 --listen tls/0.0.0.0:7448 ...\n"
        "  board51 send rig1 reference 0.003 --connect tls/10.0.0.5:7448 --identity keys/identities/ben\n"
        "  board51 security add-user keys cyd:viewer\n"
        "  board51 security add-token keys matlab --user ana --role operator\n"
        "  board51 security check keys\n"
        "  board51 security zenoh-config keys/identities/ben --connect tls/10.0.0.5:7448 --out ben.json5"
    )
    steps = parser.add_subparsers(dest="step", required=True, metavar="STEP")
    init = _step(steps, "init", "make the folder with keys, certificates and users")
    init.add_argument("--site", default=DEFAULT_SITE, help=f"first chunk of the keys (default {DEFAULT_SITE})")
    add_repeatable(init, "--host", "HOST", "name or address under which others reach this machine; repeatable")
    add_repeatable(init, "--user", _USER, f"of {', '.join(ROLE_WORDS)}")
    add = _step(steps, "add-user", "add a person, or change the role or the password of one")
    add.add_argument("user", metavar=_USER)
    for step in (init, add):
        step.add_argument(
            "--ask", action="store_true", help="ask for passwords; default: make them and print them once"
        )
    remove = _step(steps, "remove-user", "remove the login and the identity of a person")
    remove.add_argument("name")
    token = _step(steps, "add-token", "make a token by which a program logs in at /api/v1, and print it once")
    token.add_argument("name", help="name of the token, such as matlab")
    token.add_argument(
        "--user", required=True, metavar="NAME", help="user for whom the program acts: the log has this name"
    )
    token.add_argument("--role", choices=ROLE_WORDS, help="role, at most that of the user (default: that of the user)")
    withdrawn = _step(steps, "remove-token", "remove a token")
    withdrawn.add_argument("name")
    _step(steps, "renew", "make new certificates; names, roles and passwords stay")
    config = _step(steps, "zenoh-config", "write an identity as zenoh's own configuration, for clients in any language")
    config.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT", help="the router (%(default)s)")
    config.add_argument("--out", type=Path, metavar="FILE", help="write it to this file, readable by its owner only")
    check = _step(steps, "check", "check permissions and roles, and how long the certificates are valid")
    check.add_argument("--json", action="store_true", help="print the days as JSON")


def _step(
    steps: argparse._SubParsersAction[argparse.ArgumentParser],  # argparse has no public name for it
    name: str,
    description: str,
) -> argparse.ArgumentParser:
    step = steps.add_parser(name, help=description, description=f"{description[0].upper()}{description[1:]}.")
    step.add_argument("folder", type=Path, metavar="DIR")
    return step


def run(args: argparse.Namespace) -> int:
    """Do the step."""
    folder = SecurityFolder(args.folder)
    match args.step:
        case "init":
            users = [_user(text) for text in args.user]
            folder.init(site=args.site, hosts=args.host)
            print(f"{folder.path}: authority, certificates, identities of gateway, twin and views")
            for user in users:
                _add(folder, user, prompt=args.ask)
            print(f"Keep {folder.path}/ca-key.pem safe: it is needed to add people and to renew, not to run.")
        case "add-user":
            _add(folder, _user(args.user), prompt=args.ask)
            print("On the bus this counts when its router starts again.")
        case "remove-user":
            folder.remove_user(args.name)
            print(f"{args.name} is removed; on the bus this counts when its router starts again.")
        case "add-token":
            role = Role[args.role.upper()] if args.role else folder.people().get(args.user, Role.VIEWER)
            token = set_token(folder.users, args.name, User(name=args.user, role=role))
            _warn_of_open_output(f"the token {args.name}")
            print(token)
        case "remove-token":
            remove_token(folder.users, args.name)
            print(f"{args.name} is removed; this counts at once.")
        case "renew":
            folder.renew()
            print(f"{folder.path}: new certificates; copy the identity folders to their machines again")
        case "zenoh-config":
            endpoint = check_endpoint(args.connect, where="--connect")
            text = zenoh_config("client", connect=[endpoint], identity=load_identity(args.folder))
            if args.out is not None:
                write_private(args.out, f"{text}\n".encode())
            elif mode := open_output():
                problem = f"The password of the bus would be printed into a file that others may read (mode {mode})"
                raise UsageError(problem, remedy="Give --out FILE, which makes it readable by you alone")
            else:
                print(text)
        case _:
            return _check(folder, as_json=args.json)
    return 0


def _user(text: str) -> User:
    name, colon, role = text.partition(":")
    if not colon:
        raise UsageError(f"{text!r} does not name a role", remedy=f"Write {_USER}, e.g. {text or 'ana'}:operator")
    return User(name=check_name(name, what="user"), role=parse_role(role, where=f"user {name}"))


def _add(folder: SecurityFolder, user: User, *, prompt: bool) -> None:
    password = getpass.getpass(f"Password of {user.name}: ") if prompt else secrets.token_urlsafe(12)
    identity = folder.add_user(user, password)
    if not prompt:
        _warn_of_open_output(f"the password of {user.name}")
    password_text = "" if prompt else f"  password {password}"
    print(f"{user.name:<12} {user.role.word:<9} {identity}{password_text}")


def _warn_of_open_output(secret: str) -> None:
    if mode := open_output():
        print(f"others may read {secret} in the file to which it is printed (mode {mode})", file=sys.stderr)


def _check(folder: SecurityFolder, *, as_json: bool) -> int:
    left = folder.check()
    people = folder.people()
    if as_json:
        roles = {name: role.word for name, role in people.items()}
        print(json.dumps({"site": folder.site, "users": roles, "days_left": {k: round(v, 1) for k, v in left.items()}}))
        return 0
    for role in Role:
        names = ", ".join(name for name, person_role in people.items() if person_role is role)
        print(f"{role.word:<9} {names or '-'}")
    soonest = min(left, key=lambda name: left[name])
    print(f"all certificates are good; the first to expire: {soonest}, in {left[soonest]:.0f} days")
    if (folder.path / "ca-key.pem").exists():
        print("ca-key.pem is here: move it off this machine once all people are added", file=sys.stderr)
    return 0
