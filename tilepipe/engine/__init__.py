"""The engine: passes over tiles, their ledger, where they run, and the folder of a run."""
