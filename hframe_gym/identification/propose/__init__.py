"""Propose what a machine may lack: candidates of the library, ranked by linearized and by trial fits."""
