"""What people run: command line, viewer server, browser client."""
