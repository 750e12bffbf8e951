"""What every other part stands on: errors, records, storage, progress, clock. No torch, nothing else of ours."""
