"""Bad inputs of every kind: a catalogue with the message of each, and mutations of valid files for fuzzing."""
