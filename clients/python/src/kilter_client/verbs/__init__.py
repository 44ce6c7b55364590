"""What a script does with a server: typed results, references wherever an id is meant, paths or arrays for data.

Each verb is written once, as steps; ``Kilter`` waits for them, ``AsyncKilter`` awaits them.
"""
