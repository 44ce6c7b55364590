"""`kilterd zenoh-config`: certificates and access control of the stream beyond one machine."""
