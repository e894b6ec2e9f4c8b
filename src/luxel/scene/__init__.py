"""What is lit (Scene) and how it is looked at (View)."""
