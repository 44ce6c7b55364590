"""The versions of a robot: what each holds, how two differ, and which one corrects."""
