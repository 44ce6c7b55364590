"""What a stream stands on: frames, signatures, sessions, the link, and which answers it accepts."""
