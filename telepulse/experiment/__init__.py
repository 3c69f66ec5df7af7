"""Psychophysics: blinded trials of the link against direct playback, and what they show."""
