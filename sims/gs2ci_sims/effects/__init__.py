"""Physical effects, one per file. Their order is `gs2ci_sims.light_path`'s business, never an effect's."""
