"""Methods of the literature that gs2ci is compared with; the reconstruction itself uses none of them."""
