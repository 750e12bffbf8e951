"""What a preview of a measurement is derived from, part by part; `gs2ci_sims.preview` takes it."""
