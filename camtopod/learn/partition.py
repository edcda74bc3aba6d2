"""Groups of cells that are zones: a first working version, being rewritten."""
# ruff: noqa
# mypy: ignore-errors
from typing import NamedTuple
import numpy as np
from scipy.special import gammaln, gammaincc, gammainc, ndtr
from camtopod.learn.daspec import data_spectroscopy, bandwidth, kernel_1d
R,C=30,24
NU0=4.0; PSI0=5*.02**2; CAP=2000.
LOGPI=np.log(np.pi)
VAL_G=3.0; VAL_R=0.85
def lg2(a): return .5*LOGPI+gammaln(a)+gammaln(a-.5)
def CONSTf(): return -lg2(NU0/2)+NU0*np.log(PSI0)
def evidence(s):
    n=np.maximum(s[...,0],1e-9)
    xx=s[...,3]-s[...,1]**2/n; yy=s[...,5]-s[...,2]**2/n; xy=s[...,4]-s[...,1]*s[...,2]/n
    m=np.maximum(n,1.); a=.5*(NU0+m-1)
    det=(PSI0+xx)*(PSI0+yy)-xy**2
    return np.where(s[...,0]>0,-(m-1)*LOGPI-np.log(m)+lg2(a)+CONSTf()-a*np.log(det),0.)
def score(ns,evs,n0):
    K=len(ns)
    return 2*gammaln(K+1)-gammaln(ns.sum()+n0+K+1)+gammaln(ns+1).sum()+gammaln(n0+1)+evs.sum()
W=1.25
KR,KC=kernel_1d(R,W),kernel_1d(C,W)
S1=np.outer(KR.sum(0),KC.sum(0)); S2=np.outer((KR**2).sum(0),(KC**2).sum(0))
def floor(count):
    n=count.astype(float); lam=n.mean()
    for _ in range(8):
        # Poisson clip
        cut=lam+3*np.sqrt(lam)+1; lo=n[n<=cut]
        new=lo.mean()
        if abs(new-lam)<1e-6: break
        lam=max(new,1e-6)
    sm=KR@n@KC
    eff=sm*S1/S2; mean=lam*S1**2/S2
    p=gammainc(np.maximum(eff,1e-9),mean)   # P(N>=eff)
    keep=(n>0)&(p<.02)&(n>lam+2*np.sqrt(lam))
    return lam,keep
def cellstats(sums):
    st=np.stack([g.ravel() for g in sums],-1).astype(float)
    st/= np.array([1,4096,4096,4096**2,4096**2,4096**2])
    return st
def assign(st,mom,lab,K,n0):
    z=np.zeros((K,6)); np.add.at(z,lab[lab>=0],st[lab>=0])
    n=z[:,0]; 
    nn=np.maximum(n,1e-9)
    mx,my=z[:,1]/nn,z[:,2]/nn
    xx=z[:,3]-n*mx*mx; xy=z[:,4]-n*mx*my; yy=z[:,5]-n*my*my
    d=n+NU0-1
    xx=(PSI0+xx)/d; yy=(PSI0+yy)/d; xy=xy/d
    det=xx*yy-xy*xy
    dx=mom[:,0,None]-mx; dy=mom[:,1,None]-my
    q=(yy*(dx*dx+mom[:,2,None])-2*xy*(dx*dy+mom[:,3,None])+xx*(dy*dy+mom[:,4,None]))/det
    ll=np.log(nn+1)-np.log(2*np.pi)-.5*np.log(det)-.5*q
    best=ll.argmax(1)
    new=np.where(ll[np.arange(len(ll)),best]>np.log(n0+1),best,-1)
    return new
def zstats(st,lab,K):
    z=np.zeros((K+1,6)); np.add.at(z,lab,st)   # -1 -> last
    return z
ANG=np.arange(8)*np.pi/8
DIR=np.stack([np.cos(ANG),np.sin(ANG)],1)
def valley(st,mom,u,lo,hi,M=28):
    """best valley G between the two masses; lo,hi scanning range; returns (G, ratio)"""
    s=mom[:,0]*u[0]+mom[:,1]*u[1]
    v=np.sqrt(np.maximum(mom[:,2]*u[0]**2+2*mom[:,3]*u[0]*u[1]+mom[:,4]*u[1]**2,0)+1e-6)
    g=np.linspace(lo,hi,M)
    F=(st[:,0]*ndtr((g[:,None]-s)/v)).sum(1)
    n=np.maximum(F[None,:]-F[:,None],0); w=np.maximum(g[None,:]-g[:,None],1e-12)   # interval i..j
    r=n/w
    i=np.arange(M)
    # valley (i,j); left flank (k,i)
    def G(nv,wv,nf,wf):
        rr=(nv+nf)/(wv+wf); rv=nv/wv; rf=nf/wf
        out=nv*np.log(np.maximum(rv,1e-12)/np.maximum(rr,1e-12))+nf*np.log(np.maximum(rf,1e-12)/np.maximum(rr,1e-12))
        return np.where(rv<VAL_R*rf,out,0)
    k,ii,j=np.meshgrid(i,i,i,indexing="ij")
    ok=(k<ii)&(ii<j)
    k,ii,j=k[ok],ii[ok],j[ok]
    left=np.zeros((M,M)); np.maximum.at(left,(ii,j),G(n[ii,j],w[ii,j],n[k,ii],w[k,ii]))
    # right flank (j,l): reuse triple (a<b<c): valley (a,b), flank (b,c)
    right=np.zeros((M,M)); np.maximum.at(right,(k,ii),G(n[k,ii],w[k,ii],n[ii,j],w[ii,j]))
    return np.minimum(left,right).max()
def pair_valley(st,mom,lab,za,zb,ka,kb):
    """valley between groups a and b (masks), clutter cells in the tube between included."""
    def mc(z):
        n=z[0]; m=z[1:3]/n; S=np.array([[z[3],z[4]],[z[4],z[5]]])-n*np.outer(m,m)
        return n,m,(S+PSI0*np.eye(2))/(n+NU0-1)
    na,ma,Ca=mc(za); nb,mb,Cb=mc(zb)
    Wm=(na*Ca+nb*Cb)/(na+nb)
    u=np.linalg.solve(Ca+Cb,mb-ma); u/=np.hypot(*u)+1e-300
    # tube: perpendicular in the pooled metric
    p=np.array([-u[1],u[0]])
    mid=mom[:,:2]
    t=(mid-ma)@u; T=(mb-ma)@u; f=np.clip(t/T,0,1)
    cen=ma+f[:,None]*(mb-ma); dev=np.abs((mid-cen)@p); sp=np.sqrt(max(p@Ca@p,p@Cb@p))
    sel=(lab==ka)|(lab==kb)|((lab==-1)&(dev<2*sp)&(t>0)&(t<T))
    sa,sb=np.sqrt(u@Ca@u),np.sqrt(u@Cb@u)
    return valley(st[sel],mom[sel],u,ma@u-2*sa,mb@u+2*sb)
def splits(st,mom,lab,k):
    idx=np.where(lab==k)[0]
    if len(idx)<2: return None
    best=[]
    s=st[idx]; 
    pr=mom[idx,:2]@DIR.T    # (m,A)
    order=pr.argsort(0)      # (m,A)
    cs=np.cumsum(s[order],axis=0)  # (m,A,6)
    tot=cs[-1]
    L=cs[:-1]; Rr=tot[None]-L
    e0=evidence(tot[0]); n=tot[0,0]
    g=evidence(L)+evidence(Rr)+gammaln(L[...,0]+1)+gammaln(Rr[...,0]+1)-e0-gammaln(n+1)
    a=g.max(0).argsort()[::-1][:3]
    out=[]
    for q in a:
        c=g[:,q].argmax()
        out.append((g[c,q],idx[order[:c+1,q]],idx[order[c+1:,q]]))
    return out

G_ALONE=8.
def peel(g,w):
    """labels (720,) by DaSpec, again over what no kept eigenvector reaches."""
    full=np.full(R*C,-1); K=0; g=g.copy()
    for _ in range(6):
        sp=data_spectroscopy(g,w)
        eps=sp.vectors.max(0)*max(1/g.sum(),1e-3)
        own=sp.vectors[np.arange(len(sp.cells)),sp.labels]>eps[sp.labels]
        full[sp.cells[own]]=sp.labels[own]+K; K+=sp.groups
        g.ravel()[sp.cells[own]]=0
        if not g.any() or not own.any(): break
    return full,K
def gains(zs,ev,n0):
    """score gain of merging each pair"""
    K=len(zs); a,b=np.triu_indices(K,1)
    zz=zs[a]+zs[b]
    e=evidence(zz)-ev[a]-ev[b]
    N=zs[:,0].sum()+n0
    pr=2*gammaln(K)-2*gammaln(K+1)-gammaln(N+K)+gammaln(N+K+1)
    return a,b,zz,e+pr+gammaln(zz[:,0]+1)-gammaln(zs[a,0]+1)-gammaln(zs[b,0]+1)
def separate(gain,v):
    """gain: of the split (score)."""
    return v>=VAL_G and (gain>0 or v>=G_ALONE)
def near(za,zb):
    def mc(z):
        n=z[0]; m=z[1:3]/n; S=np.array([[z[3],z[4]],[z[4],z[5]]])-n*np.outer(m,m)
        return n,m,(S+PSI0*np.eye(2))/(n+NU0-1)
    na,ma,Ca=mc(za); nb,mb,Cb=mc(zb); d=mb-ma
    u=np.linalg.solve(Ca+Cb,d); 
    return abs(u@d)/(np.sqrt(u@Ca@u)+np.sqrt(u@Cb@u)+1e-300)
NEAR=3.
def compact(lab):
    u,inv=np.unique(lab[lab>=0],return_inverse=True); lab=lab.copy(); lab[lab>=0]=inv
    return lab,len(u)
def settle(st,mom,lab,K,keepocc,verbose):
    for rnd in range(6):
        changed=False
        lab,K=compact(lab)
        z=zstats(st,lab,K); zs,n0=z[:-1],z[-1,0]; ev=evidence(zs)
        if verbose: print("  round",rnd,zs[:,0].round(1),"clutter",n0.round(1))
        known={}
        while K>1:
            a,b,zz,g=gains(zs,ev,n0)
            o=np.argsort(-g); best=None
            for q in o:
                key=(zs[a[q]].tobytes(),zs[b[q]].tobytes())
                if key in known: v=known[key]
                elif near(zs[a[q]],zs[b[q]])>NEAR: v=7.9
                else: v=pair_valley(st,mom,lab,zs[a[q]],zs[b[q]],a[q],b[q])
                known[key]=v
                if not separate(-g[q],v): best=q;break
            if best is None: break
            A,B=a[best],b[best]
            if g[best]<0:
                base=score(zs[:,0],ev,n0)
                k=A if zs[A,0]<zs[B,0] else B
                d=score(np.delete(zs[:,0],k),np.delete(ev,k),n0+zs[k,0])-base
                if d>g[best]:
                    if verbose: print("   drop-not-merge",zs[k,0].round(1),d.round(1))
                    n0+=zs[k,0]; lab[lab==k]=-1; lab[lab>k]-=1; zs=np.delete(zs,k,0); ev=np.delete(ev,k); K-=1; changed=True
                    continue
            if verbose: print("   merge",zs[A,0].round(1),zs[B,0].round(1),g[best].round(1))
            lab[lab==B]=A; lab[lab>B]-=1; zs[A]=zz[best]; zs=np.delete(zs,B,0); ev=evidence(zs); K-=1; changed=True
        while K>1:
            base=score(zs[:,0],ev,n0)
            d=[score(np.delete(zs[:,0],k),np.delete(ev,k),n0+zs[k,0])-base for k in range(K)]
            k=int(np.argmax(d))
            if d[k]<=0: break
            if verbose: print("   drop",zs[k,0].round(1),d[k].round(1))
            n0+=zs[k,0]; lab[lab==k]=-1; lab[lab>k]-=1; zs=np.delete(zs,k,0); ev=np.delete(ev,k); K-=1; changed=True
        old=lab
        for _ in range(2):
            lab=assign(st,mom,lab,K,st[lab<0,0].sum())
        lab,K=compact(lab)
        if K==0: break
        z=zstats(st,lab,K); zs,n0=z[:-1],z[-1,0]; ev=evidence(zs)
        for k in range(K):
            out=splits(st,mom,lab,k)
            if not out: continue
            base=score(zs[:,0],ev,n0)
            for g,a,b in out:
                za,zb=st[a].sum(0),st[b].sum(0)
                ns=np.append(np.delete(zs[:,0],k),[za[0],zb[0]]); ee=np.append(np.delete(ev,k),evidence(np.stack([za,zb])))
                gain=score(ns,ee,n0)-base
                if gain<=-20: continue
                l2=lab.copy(); l2[b]=K; 
                v=pair_valley(st,mom,l2,za,zb,k,K)
                if verbose: print("   try split",k,"gain",round(gain,1),"valley",round(v,2),za[0],zb[0])
                if not separate(gain,v): continue
                lab=l2; K+=1; zs=np.vstack([zs,zb]); zs[k]=za; ev=evidence(zs); changed=True
                break
        if not changed: break
    z=zstats(st,lab,K)
    return lab,K,score(z[:-1,0],evidence(z[:-1]),z[-1,0])

class Cells(NamedTuple):
    stats: np.ndarray
    index: np.ndarray
    @classmethod
    def of(cls, stats, index):
        return cls(stats, index)


def partition(cells, count, scales=(1.0, 0.5)):
    lam,keep=floor(count)
    st,occ=cells.stats.astype(float),cells.index
    n=st[:,0]; mx,my=st[:,1]/n,st[:,2]/n
    mom=np.stack([mx,my,np.maximum(st[:,3]/n-mx*mx,0),st[:,4]/n-mx*my,np.maximum(st[:,5]/n-my*my,0)],1)
    ntot=n.sum()
    if ntot<5: return np.zeros(len(occ),int)
    st=st*(CAP/(CAP+ntot))
    best=None
    g=np.where(keep,np.maximum(count-lam,.5),0)
    if not keep.any(): g=count.astype(float)
    w0=min(bandwidth(g),4.)
    for sc in scales:
        w=max(.75,w0*sc)
        full,K=peel(g,w); lab=full[occ]
        r=settle(st,mom,lab,K,keep.ravel()[occ],False)
        if best is None or r[2]>best[2]: best=r
        if w==.75: break
    lab,K,_=best
    return lab if K else np.zeros(len(occ),int)
