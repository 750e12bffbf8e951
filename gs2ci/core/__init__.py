"""The base of all other packages: errors, records, storage, progress, clock. It imports no torch and no other part."""
