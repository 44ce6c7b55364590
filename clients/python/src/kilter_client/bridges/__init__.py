"""Bridges: a small process between a controller and its arm's correction, with the corrector in the process itself.

Nothing goes over the network between a request of the controller and its answer. A second process, the companion, follows
the server and publishes what the bridge does; it may hang or die without a cycle being late.
"""
