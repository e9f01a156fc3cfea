"""Private: files of frames and of raw bytes, one module for each format.

`canser` has the public names. `canser.files.formats` says what a format needs.
"""
