"""Who may ask for what: the checks of a request, without side effects."""

import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, final

# The largest body of a command, bytes.
MAX_BODY = 4096

# The longest time in which a body must arrive, s.
BODY_SECONDS = 2.0

# The names of this machine for itself.
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")

_HOST = re.compile(r"(\[[0-9a-f:]{2,45}\]|[a-z0-9.-]{1,253})(:[0-9]{1,5})?")


@final
class Refusal(NamedTuple):
    """Why a request is refused. `status` is that of HTTP."""

    status: int
    text: str


@final
@dataclass(frozen=True)
class Access:
    """The rules of a server.

    **Arguments:**

    - `hosts`: the names by which browsers may call it, with the port where it is in the address. A
      page of another site that resolves its own name to this machine is thus refused.
    - `token`: the secret of those who may command.
    - `allow_control`: whether anything but a stop may be commanded.
    """

    hosts: frozenset[str]
    token: str
    allow_control: bool

    @classmethod
    def of(
        cls, host: str, port: int, *, names: tuple[str, ...] = (), allow_control: bool = False
    ) -> "Access":
        """The rules of a server at an address, with a new token.

        **Arguments:**

        - `host`, `port`: where it listens.
        - `names`: further names, such as that of a reverse proxy.
        """
        own = (*LOOPBACK, f"[{host}]" if ":" in host else host.lower())
        at_port = [f"{name}:{port}" for name in own]
        plain = own if port == 80 else ()
        return cls(
            frozenset((*at_port, *plain, *(name.lower() for name in names))),
            secrets.token_urlsafe(24),
            allow_control,
        )

    def refuse_read(self, headers: Mapping[str, str]) -> Refusal | None:
        """Checks a request that changes nothing. Returns why it is refused, None if it is not.

        **Arguments:**

        - `headers`: those of the request, names in lower case.
        """
        host = headers.get("host", "").lower()
        if not _HOST.fullmatch(host) or host not in self.hosts:
            return Refusal(403, "host: expected a name that this server was started with")
        origin = headers.get("origin")
        if origin is not None and not self._is_own(origin, host):
            return Refusal(403, "origin: expected this page's own")
        return None

    def refuse_command(self, headers: Mapping[str, str], *, needs_control: bool) -> Refusal | None:
        """Checks a command, before its body is read. Returns why it is refused, None if it is
        not."""
        refusal = self.refuse_read(headers)
        if refusal is not None:
            return refusal
        if "origin" not in headers:
            return Refusal(403, "origin: expected this page's own, got none")
        if headers.get("sec-fetch-site", "same-origin") != "same-origin":
            return Refusal(403, "sec-fetch-site: expected same-origin")
        content = headers.get("content-type", "").partition(";")[0].strip().lower()
        if content != "application/json":
            return Refusal(415, "content-type: expected application/json")
        if headers.get("content-encoding", "identity") != "identity":
            return Refusal(415, "content-encoding: expected none")
        length = headers.get("content-length", "0")
        if not re.fullmatch("[0-9]{1,9}", length):
            return Refusal(400, "content-length: expected a number of bytes")
        if int(length) > MAX_BODY:
            return Refusal(413, f"expected at most {MAX_BODY} bytes")
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind != "Bearer" or not given:
            return Refusal(401, "authorization: expected the token that the server printed")
        # In constant time: how long it takes says nothing of how much is right.
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return Refusal(401, "authorization: the token is wrong")
        if needs_control and not self.allow_control:
            return Refusal(403, "this server only shows; start it with --allow-control")
        return None

    @staticmethod
    def _is_own(origin: str, host: str) -> bool:
        return origin.lower() in (f"http://{host}", f"https://{host}")
