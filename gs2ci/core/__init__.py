"""The base of all other parts: errors, records, storage, progress, clock. No torch, nothing else of ours."""
