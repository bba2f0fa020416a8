"""Bad inputs of every kind: a catalogue with the message of each, and mutants of valid files for fuzzing."""
