"""What switches the cells off: interlocks and limits.

An interlock (`_interlock`) turns records, what is known of the rig and the time into a `Finding`,
without side effects. `_guard` asks all of them: `_plausibility`, `_presence`, `_obedience`,
an alarm of a monitor where the rig file wants it, and `_twin_watch`, which runs twins beside the
rig and judges whether readings follow the duty (`_duty_response`), and, by draws of the twin
(`_twin_ensemble`), how hot the duty has made the rig whatever they show (`_hidden_heat`).
`_off_watch` tells by the readings after a run whether the rig is off.
`_operating_limits` are the limits of a rig as numbers.

To add an interlock, write a class in a file of its own, and enter it in `interlocks_of`.
"""
