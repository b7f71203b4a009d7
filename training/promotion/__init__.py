"""The one door to python-tuf in the laboratory: keys, signed releases, and the repository that units read.

keys          key files, and who can sign with what
repository    the folder: reading what is published, writing it whole
change        a change of root or targets: signed by one holder after another, published once it is complete
ceremony      a repository is begun; keys come and go; dates are renewed
publication   a bundle becomes the release of a ring; old bundles go
verification  what a unit would say to the folder
decision      what may be promoted
overview      the folder, for people
"""
