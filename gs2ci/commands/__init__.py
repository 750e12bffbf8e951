"""One file per subcommand; each has one run() that returns the path it wrote."""
