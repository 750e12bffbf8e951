"""How sure a reconstruction is: standard errors of views, depths and poses, from what the readings determine."""
