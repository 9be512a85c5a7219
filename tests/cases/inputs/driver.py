import numpy

NET = numpy.load("driver.npz")
