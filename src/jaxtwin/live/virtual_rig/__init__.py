"""A simulated rig behind the protocol: a plant, a camera's picture, faults and servers.

`_virtual_rig` is the device with its camera, `_plant` the twin that it measures and drives;
`_serve` puts it behind TCP, a pseudo-terminal, a broker, or into this process.
"""
