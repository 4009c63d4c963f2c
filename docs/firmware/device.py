"""A controller of protocol version 2 (docs/protocol.md) on a TCP port: MicroPython or CPython.

Its tests run it under CPython. Under MicroPython, connect to the network first, then `serve(7000)`.
"""

import binascii
import os
import select
import socket
import sys
import time

RIG, CELLS, COUNTS, WATCHDOG_S, PERIOD_S = "dual-cell", ("P1", "P2"), 255, 2, 0.1
BOOT = binascii.hexlify(os.urandom(4)).decode()  # another one at every start
LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.-"
KEYS = {"duty": ["n", "owner", "pwm"], "relay": ["n", "name", "owner"]}
KEYS.update((word, ["n", "owner"]) for word in ("stop", "reset", "release"))
RELAY = ""  # the name of the relay in [limits] of the rig file, such as "power%20off"


try:
    ticks, passed = time.ticks_ms, time.ticks_diff  # MicroPython, which begins anew at 2^30
except AttributeError:

    def ticks():
        return int(time.monotonic() * 1000)

    def passed(now, before):
        return now - before


def set_pins(pwm):
    """Yours: machine.PWM(...).duty_u16(...); direction pins first, under no current."""


def set_relay(on):
    """Yours: the pin of the relay in the supply, if there is a RELAY."""


def fault():
    """Yours: "over-temperature" where a sensor of the controller's own says so."""
    return ""


class Device:
    def __init__(self):
        self.numbers, self.out, self.trip, self.heard = {"data": 0, "event": 0}, b"", "", 0.0
        self.newest = "", 0  # the owner and the number of the last duty that was applied
        self.off()
        self.supply(True)

    def supply(self, on):
        self.supplied = on or not RELAY
        set_relay(self.supplied)

    def off(self):
        self.pwm, self.owner, self.n = [0] * len(CELLS), "", None
        set_pins(self.pwm)

    def say(self, text):
        self.out += f"{text}*{checksum(text.encode())}\n".encode()

    def tell(self, kind, now, rest):
        self.say(f"{kind} seq={self.numbers[kind]} t={int(now * 1e6)}{rest}")
        self.numbers[kind] = (self.numbers[kind] + 1) % 2**32

    def hello(self):
        self.say(
            f"hello version=2 rig={RIG} boot={BOOT} cells={','.join(CELLS)} counts={COUNTS}"
            f" watchdog={WATCHDOG_S}" + (" relay=" + RELAY if RELAY else "")
        )

    def trips(self, why, now):
        self.supply(False)
        self.off()
        if not self.trip:  # the first reason says what to look for
            self.trip = why
            self.tell("event", now, " kind=trip why=" + why)

    def refusal(self, owner, n, pwm):
        if self.owner not in ("", owner):
            return "owner"
        if self.trip:
            return "tripped"
        if len(pwm) != len(CELLS) or max(map(abs, pwm)) > COUNTS:
            return "range"  # not cut to what is possible
        old = owner == self.newest[0] and not 0 < (n - self.newest[1]) % 2**32 < 2**31
        return "old" if old else ""

    def obey(self, line, now):
        text, star, crc = (line[:-1] if line.endswith(b"\r") else line).rpartition(b"*")
        if len(line) >= 1024 or not star or crc != checksum(text).encode():
            return
        word, *rest = text.decode().split(" ")
        fields = dict(part.split("=", 1) for part in rest)
        if word == "hello" and "rig" not in fields:  # else it is a device that speaks
            if fields["version"] != "2" or len(rest) == 1:
                self.hello()
        elif word in KEYS and len(fields) == len(rest) and sorted(fields) == KEYS[word]:
            self.command(word, whole(fields["n"], 0), fields, now)

    def command(self, word, n, fields, now):
        owner = fields["owner"]
        if not 0 < len(owner) < 33 or any(letter not in LETTERS for letter in owner):
            return
        about, refused = f" owner={owner} n={n}", ""
        if word == "duty":
            pwm = [whole(part, -(2**31)) for part in fields["pwm"].split(",")]
            refused = self.refusal(owner, n, pwm)
            if not refused:
                self.pwm, self.owner, self.n, self.newest = pwm, owner, n, (owner, n)
                self.heard = now  # only this feeds the watchdog
                set_pins(pwm)
        elif word == "stop":
            self.trips("stop", now)
        elif word == "relay" and RELAY and fields["name"] == RELAY:
            self.trips("relay", now)
        elif word == "relay":
            refused = "relay"
        elif word == "reset" and self.trip:
            self.trip = ""
            self.supply(True)
            self.tell("event", now, " kind=reset" + about)
        elif self.owner not in ("", owner):
            refused = "owner"
        elif word == "release":
            self.off()
        if refused:
            self.tell("event", now, " kind=refused why=" + refused + about)

    def check(self, now):
        if any(self.pwm) and fault():
            self.trips(fault(), now)
        if self.owner and now - self.heard > WATCHDOG_S:
            self.trips("watchdog", now) if any(self.pwm) else self.off()

    def sample(self, now):
        state = f" owner={self.owner} n={self.n}" if self.owner else ""
        state += " trip=" + self.trip if self.trip else ""
        state += " relay=" + ("on" if self.supplied else "off") if RELAY else ""
        self.tell("data", now, " pwm=" + ",".join(map(str, self.pwm)) + state)


def checksum(text):
    return f"{binascii.crc32(text) & 0xFFFFFFFF:08X}"


def whole(text, least):
    number = int(text)
    if str(number) != text or not least <= number < 2**32:  # no 007, no +1, no -0
        raise ValueError(text)
    return number


def serve(port):
    device, hosts, last, now, sent = Device(), {}, ticks(), 0.0, 0.0
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", port))  # "0.0.0.0" to be seen from outside: see docs/protocol.md
    listener.listen(4)
    print(f"listening on port {port}")
    while True:
        ready = select.select([listener, *hosts], [], [], PERIOD_S / 5)[0]
        now += passed(ticks(), last) / 1000
        last = ticks()
        for host in ready:
            if host is listener:
                host = listener.accept()[0]
                host.setblocking(False)  # who does not read must not keep the watchdog waiting
                hosts[host] = b""
                device.hello()
                continue
            try:
                data = host.recv(512)
            except OSError:
                data = b""
            *lines, rest = (hosts.pop(host) + data).split(b"\n")
            if data:
                hosts[host] = rest[-1024:]
            for line in lines:
                try:
                    device.obey(line, now)
                except (ValueError, KeyError, UnicodeError):
                    continue  # a damaged or unknown line changes nothing
        device.check(now)
        if now - sent >= PERIOD_S:
            sent = now
            device.sample(now)
        out, device.out = device.out, b""
        for host in list(hosts):
            try:
                sent_all = not out or host.send(out) == len(out)
            except OSError:
                sent_all = False
            if not sent_all:
                host.close()
                del hosts[host]


if __name__ == "__main__":
    serve(int(sys.argv[1]) if len(sys.argv) > 1 else 7000)
