"""The full screen of `mbtool watch`, drawn with textual; loaded only by that command."""
