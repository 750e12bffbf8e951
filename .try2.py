import sys,time; sys.path[:0]=["/mnt/share","/mnt/share/drivers","/mnt/share/sims"]
t=time.monotonic(); import numpy as np; print("numpy",time.monotonic()-t,flush=True)
t=time.monotonic(); import numba; print("numba",time.monotonic()-t,flush=True)
t=time.monotonic()
from gs2ci_drivers.dlpc900 import erle
from gs2ci_sims.wires import dlpc900_images
print("imp",time.monotonic()-t,flush=True)
w=np.zeros((1080,1920),np.uint32); w[100:500,200:900]=0xff00ff
t=time.monotonic(); b=erle.encode(w); print("enc",len(b),time.monotonic()-t,flush=True)
t=time.monotonic(); b=erle.encode(w); print("enc2",len(b),time.monotonic()-t,flush=True)
t=time.monotonic(); o=np.zeros(w.size,np.uint32); print(dlpc900_images._read_erle(np.frombuffer(b,np.uint8),1920,o)); print("dec",time.monotonic()-t,flush=True)
