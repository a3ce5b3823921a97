"""Line elements of least energy between labelled pixels."""
