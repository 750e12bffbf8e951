"""Camera path and depth from decoded views."""
