"""The integer program (program), its interpreter, and the engine that runs it as fast as C."""
