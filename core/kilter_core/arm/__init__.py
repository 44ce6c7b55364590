"""The arm as it is made: chain, robot, loads, and the documents and conventions it is written in."""
