"""The wire: bytes become frames, messages and records, and commands become bytes.

`_framing` cuts bytes into frames, `_codec` reads and writes the messages (`_messages`) in them,
`_receiver` makes records (`_records`) of them, each message once (`_message_counts`).
`_link` is the only thread; `_transport` and `_mqtt_transport` are what it reads.
`_rig_connection` joins the links of a rig into one stream of records, which its journal gets first.
`_rig_state` folds records into what is known of the rig now. `_output_stage` is what a device does
with commands; `_board_device` does it for a board that only answers, such as `_tclab`.
docs/protocol.md specifies the wire.
"""
