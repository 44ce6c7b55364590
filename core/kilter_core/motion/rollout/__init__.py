"""Commands and readings of a simulated arm's joints: the servo by output error, and what it lacks."""
