"""The blind check: another engine simulates reality, a camera films it, and the answers stay sealed until scoring.

Nothing in here knows the effects of `invdyn.models`: a mechanism is the engine's own part or an applied force, so
that a slip in an effect's equation cannot hide behind the same slip in its test.
"""
