"""The options of an identification, and reading and writing them as TOML."""
