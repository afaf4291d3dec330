"""What `make bench` measures. Every number is a time or count taken on the machine at hand, what is
compared is interleaved in one run.
"""
