"""Commands for cameras: boards to print, boards in pictures, and where cameras stand."""
