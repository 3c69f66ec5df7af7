"""The finger's own press: its set-points for the wrist, and the local model of the tissue."""
