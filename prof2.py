import pickle,cProfile,pstats,tempfile
from warp_partdr.results.save_photo import save_photo_fit
name,photo,fit=pickle.load(open("/tmp/page/079_meeting.pkl","rb"))
d=tempfile.mkdtemp()
save_photo_fit(fit,d,photo=photo)
p=cProfile.Profile();p.enable();save_photo_fit(fit,d,photo=photo);p.disable()
pstats.Stats(p).sort_stats("tottime").print_stats(14)
