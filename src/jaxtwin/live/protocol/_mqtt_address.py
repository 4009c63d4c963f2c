"""Parses the address of a broker, `mqtt://user:password@host:port/topic`."""

import re
from dataclasses import dataclass, field
from typing import final
from urllib.parse import parse_qsl, unquote, urlsplit

from ...errors import LinkError

EXPECTED = "mqtt://[user[:password]@]host[:port]/topic, or mqtts:// with TLS"

_FILES = ("ca", "cert", "key")
_PORTS = {"mqtt": 1883, "mqtts": 8883}
_PASSWORD = re.compile(r"(\w+://[^/?#:@\s]*):[^/?#\s]*@")


@final
@dataclass(frozen=True)
class MqttAddress:
    """A topic of a broker.

    **Arguments:**

    - `host`, `port`, `topic`: the host and port of the broker, and the topic.
    - `user`, `password`: the name and the password; `None` if the address has none.
    - `tls`: whether the connection is encrypted (`mqtts://`).
    - `ca`, `cert`, `key`: the files of the certificate authority, and of the client's certificate
      and key, from `?ca=FILE&cert=FILE&key=FILE`; `None`: the authorities of the system, and no
      certificate.
    """

    host: str
    port: int
    topic: str
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: bool = False
    ca: str | None = None
    cert: str | None = None
    key: str | None = None

    @classmethod
    def parse(cls, url: str) -> "MqttAddress":
        """Parses a URL.

        **Raises:** `LinkError`, without the password, if it is not an MQTT address.
        """
        shown = without_password(url)
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError:
            raise LinkError(f"link: expected {EXPECTED}, got {shown!r}") from None
        topic = unquote(parts.path.strip("/"))
        if parts.scheme not in _PORTS or not host or not topic:
            raise LinkError(f"link: expected {EXPECTED}, got {shown!r}")
        if "#" in url or re.search(r"[+#\0]", topic):
            raise LinkError(f"link: expected a topic without + and #, got {shown!r}")
        files = dict(parse_qsl(parts.query, keep_blank_values=True))
        tls = parts.scheme == "mqtts"
        if set(files) - set(_FILES) or (files and not tls) or ("key" in files) != ("cert" in files):
            raise LinkError(
                "link: expected mqtts:// and behind the ? ca=FILE, or cert=FILE&key=FILE, "
                f"got {shown!r}"
            )
        return cls(
            host,
            port or _PORTS[parts.scheme],
            topic,
            None if parts.username is None else unquote(parts.username),
            None if parts.password is None else unquote(parts.password),
            tls,
            **files,
        )


def without_password(url: str) -> str:
    """Removes the password from a link, so that it may be written to logs and recordings; also from
    a link inside other text, such as `--link=mqtt://...`."""
    return _PASSWORD.sub(r"\1:***@", url)
