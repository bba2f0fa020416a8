"""The file of a machine, machine.json: schema, reader with its messages and writer."""
