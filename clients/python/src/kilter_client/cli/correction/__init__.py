"""Commands that use a version: paths, programs, controllers, servos and simulators."""
