"""Can any bytes crash the parsers, or make them keep more and more of them?

    pip install atheris
    python benchmarks/live_fuzz.py -max_total_time=600 -rss_limit_mb=1024

Coverage-guided (atheris, libFuzzer). What is fed is cut in two ways; both must give the same
frames. A crash ends the run with a traceback and a file that repeats it.
"""

import struct
import sys
import tempfile
import zlib
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["jaxtwin.live"]):  # pyright: ignore
    import jaxtwin as jt
    from jaxtwin.live import Hello, LinkState, deframe, encode
    from jaxtwin.live.protocol._framing import PACKET_BYTES, encode_line, encode_packet
    from jaxtwin.live.protocol._identity import Identity
    from jaxtwin.live.protocol._link import Arrived
    from jaxtwin.live.protocol._receiver import Receiver
    from jaxtwin.live.protocol._records import LinkChange

IDENTITY = Identity.of(jt.load_rig("dual-cell"))
HELLO = encode(Hello(2, "dual-cell", "fuzz", ("P1", "P2"), camera=(80, 60), watchdog=2.0))
NOW = 1_700_000_000_000_000_000


def feed(data: bytes) -> None:
    """One input: as raw bytes, as the text of a valid line, as the content of a valid packet."""
    if len(data) < 2:
        return
    kind, cut, content = data[0] % 3, data[1] * 40, data[2:]
    if kind == 1:
        text = bytes(32 + byte % 95 for byte in content[:1000])
        content = b"%s*%08X\n" % (text, zlib.crc32(text)) if text else b""
    elif kind == 2:
        content = encode_packet(b"\x01\x00" + content)
    whole = deframe(b"", content)
    first = deframe(b"", content[:cut])
    second = deframe(first.remainder, content[cut:])
    assert first.frames + second.frames == whole.frames
    assert first.discarded + second.discarded == whole.discarded
    assert len(whole.remainder) <= PACKET_BYTES + 2

    receiver = Receiver("link", IDENTITY)
    receiver.changed(LinkChange("link", NOW, LinkState.CONNECTING, ""))
    receiver.receive(Arrived("link", NOW, HELLO))
    records = receiver.receive(Arrived("link", NOW + 1, content))
    assert len(records) <= len(content) + 3


SEEDS = (
    b"\x00\x01" + HELLO,
    b"\x00\x01" + encode_line("beat t=1") * 3 + encode_packet(b"\x01\x00x") + HELLO,
    b"\x01\x00data seq=1 t=2 pwm=1,2 ambient=3.5",
    b"\x01\x00data seq=1 t=2 pwm=1,2 temp=1.5,2.5",
    b"\x01\x00event seq=1 t=2 kind=watchdog",
    b"\x01\x00duty n=1 pwm=1,2",
    b"\x01\x00" + HELLO[:-10],
    b"\x02\x10" + struct.pack("<BxIQHH", 0, 1, 2, 80, 60) + bytes(9600),
)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(SEEDS):
            Path(folder, str(number)).write_bytes(seed)
        atheris.Setup([*sys.argv, "-max_len=12000", folder], feed)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
