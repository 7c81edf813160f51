"""One scan to corners (III-A.1): dense scan, clustering, segments, corners."""
