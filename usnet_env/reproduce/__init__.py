"""One file for each table or figure of the paper; here, and in the command line, both packages are known."""
