"""Light transport."""
