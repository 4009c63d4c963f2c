"""A live rig: links, protocol, recorder, drive, virtual rig, replay.

A live program is one loop (`_service`): a source of records (a connection, a replay, a virtual rig
in the process) is polled, each record is folded into a `RigState`, what is known of the rig now,
and both go to every consumer. Bytes become records, which are written to the recording (the
journal) before any other part of the program gets them. The rooms, of which each imports only those
before it:

- `protocol/`: bytes (`_framing`, `_codec`, `_receiver`; `_link` is the only thread), records, and
  `RigState`, whose times are those of the device; what a device does by itself (`_output_stage`;
  the example firmware in `docs/firmware/` does the same), and boards that do not (`_board_device`)
- `recording/`: the recorder and its tables, the replay, the report
- `conformance/`: the test of a device's firmware
- `safety/`: interlocks without side effects, limits, and the `Guard` of a run
- `virtual_rig/`: the simulated rig behind the protocol

Beside the rooms: `_operate` commands a rig behind its guard, `_readiness` says when it may begin,
`_switch_off` ends; `_follower`, `_alarms`, `_publisher` and `_screen` are consumers; `_prove` tests
that the interlocks act; `_json` is a record as JSON.

docs/reliability.md states the guarantees, docs/protocol.md specifies the protocol.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
