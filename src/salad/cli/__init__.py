"""The command line: one frozen dataclass a command, whose fields are its options."""
