"""Pictures, tables and recordings of a comparison; nothing here is imported unless it is asked for.

``plots`` needs matplotlib, ``recording`` needs rerun, ``tables`` needs rich.
"""
