"""Code that several parts of the bench share: processes, measuring, figures, recordings, tables."""
