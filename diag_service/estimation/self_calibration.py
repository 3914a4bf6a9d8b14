"""EXPERIMENT"""
from dataclasses import dataclass, replace
import numpy as np
from clutch_model.calibration import Calibration
from diag_service.estimation.balance import Balance
from diag_service.estimation.belief import Belief
from diag_service.estimation.parameters import Considered, State, friction_rows
from diag_service.estimation.estimator import Estimator, planned_drives, _on_coming
from diag_service.estimation.signals import gather
from diag_service.records import Reason

NS=len(State); NP=NS+len(Considered)
def C(k): return NS+int(k)

def shifted(cal, x):
    """calibration with the considered means moved by x (NP,) ; states handled separately"""
    b=cal.bias
    b=replace(b,torque_gain=b.torque_gain+x[C(Considered.TORQUE_GAIN)],torque_latency_s=b.torque_latency_s+x[C(Considered.TORQUE_LATENCY)],
      pressure_latency_s=b.pressure_latency_s+x[C(Considered.PRESSURE_LATENCY)],motoring_gain=b.motoring_gain+x[C(Considered.MOTORING_GAIN)])
    side=replace(cal.input_side,engine_inertia_kg_m2=cal.input_side.engine_inertia_kg_m2*(1+x[C(Considered.ENGINE_INERTIA)]))
    cl=tuple(replace(c,geometry=replace(c.geometry,piston_area_m2=c.geometry.piston_area_m2*(1+x[C(Considered.PISTON_AREA1+m)])),
        piston=replace(c.piston,spring_preload_n=c.piston.closed_spring_force_n*(1+x[C(Considered.PISTON_AREA1+m)])-c.piston.spring_rate_n_m*c.piston.fill_stroke_m)) for m,c in enumerate(cal.clutches))
    v=replace(cal.viscosity,a_pa_s=cal.viscosity.a_pa_s*(1+x[C(Considered.VISCOSITY)]))
    return replace(cal,bias=b,input_side=side,clutches=cl,viscosity=v)

def solve(events, cal0, prior_std, considered=(), passes=6, verbose=False, fix_bias=True):
    """prior_std (NP,) relative to cal0"""
    b0=Belief.fresh(cal0)
    mean=np.concatenate([b0.mean,np.zeros(NP-NS)])   # states absolute; considered relative to cal0 as displacement
    prior=mean.copy(); P0i=np.diag(1/np.square(prior_std))
    est=[i for i in range(NP) if i not in considered]
    cal=cal0; info=None
    for it in range(passes):
        est_=Estimator(cal)
        L=P0i.copy(); g=P0i@(prior-mean)
        belief=replace(Belief.fresh(cal),mean=mean[:NS].copy())
        chi=[]; n=0
        for ev in events:
            sig=gather(ev,cal)
            if isinstance(sig,Reason): continue
            clutch=_on_coming(ev.to_gear)
            for m,p in enumerate(sig.pressure):
                early=p.value[p.times_s<sig.grid_s[0]+.1]
                if len(early)>=3 and np.max(early)<=.3e5+abs(mean[State.ZERO1+m]):
                    w=len(early)/cal.noise.pressure_pa**2; k=State.ZERO1+m
                    L[k,k]+=w; g[k]+=w*(np.mean(early)-mean[k])
            drives=est_._drives(sig,belief,ev)
            win=est_._window(sig,drives,clutch)
            if win is None: continue
            bal=Balance(sig,win,drives,planned_drives(sig,drives,win),cal)
            belief=replace(belief,clutch_temperature_k=(bal.tracks[0].final_clutch_k,bal.tracks[1].final_clutch_k),temperature_ns=ev.end_ns)
            ms=bal.measurement(mean[:NS],mean[:NS])
            H=np.hstack([ms.by_state,ms.by_considered])
            Ri=np.linalg.inv(ms.noise)
            c2=ms.residual@Ri@ms.residual/len(ms.residual)
            chi.append(c2)
            if it>=3 and c2>4: continue
            n+=1
            L+=H.T@Ri@H; g+=H.T@Ri@ms.residual
        A=L[np.ix_(est,est)]
        dx=np.zeros(NP); dx[est]=np.linalg.solve(A,g[est])
        mean=mean+dx
        cal=shifted(cal0,np.concatenate([np.zeros(NS),mean[NS:]]))
        if verbose: print(it,n,'chi',np.round(np.mean(chi),2),np.max(chi).round(2),'dx',np.round(dx,5))
    cov=np.zeros((NP,NP)); cov[np.ix_(est,est)]=np.linalg.inv(A)
    co=list(considered); S=np.zeros((NP,len(co)))
    S[est]=-np.linalg.solve(A,L[np.ix_(est,co)])*-1 if co else 0
    cons=np.square(prior_std[co]) if co else np.zeros(0)
    return mean,cov,S,cons,cal,np.array(chi)
