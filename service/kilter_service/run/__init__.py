"""The server's processes and commands: `kilterd`, the HTTP application, backup, doctor; nothing imports it."""
