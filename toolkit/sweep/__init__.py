"""The exact image of a moving ball, and the motion that makes it most likely."""
