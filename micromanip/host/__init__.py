"""The host process: starts, feeds and watches the loop; talks to people."""
