//! Places of the surface next to each other: noise is not shared between them, missing physics is.

use super::study::Study;

/// Neighbours are nearer to each other than this many times the distance between sites.
const REACH: f32 = 2.2;
/// Their normals differ less than this says (cosine).
const ALIKE: f32 = 0.7;

/// Pairs of neighbouring sites, each once, the first site the one of lower index.
pub fn sites(study: &Study<'_>) -> Vec<[u32; 2]> {
    let reach = REACH * study.seen.spacing;
    let sites = &study.seen.sites;
    let mut pairs = Vec::new();
    for a in 0..sites.len() {
        for b in a + 1..sites.len() {
            let close = sites[a].point.position.distance(sites[b].point.position) < reach
                && sites[a].point.normal.dot(sites[b].point.normal) > ALIKE;
            if close {
                pairs.push([a as u32, b as u32]);
            }
        }
    }
    pairs
}

/// Pairs of views of neighbouring sites by the same frame, of those views that `counted` names; in the order of `sites`.
pub fn views(
    study: &Study<'_>,
    sites: &[[u32; 2]],
    counted: impl Fn(usize) -> bool,
) -> Vec<[u32; 2]> {
    let seen = &study.seen;
    let mut pairs = Vec::new();
    for [a, b] in sites.iter().map(|pair| pair.map(|site| site as usize)) {
        let (mut i, mut j) = (seen.offsets[a], seen.offsets[b]);
        while i < seen.offsets[a + 1] && j < seen.offsets[b + 1] {
            let (fi, fj) = (seen.views[i].frame, seen.views[j].frame);
            if fi == fj {
                if counted(i) && counted(j) {
                    pairs.push([i as u32, j as u32]);
                }
                (i, j) = (i + 1, j + 1);
            } else if fi < fj {
                i += 1;
            } else {
                j += 1;
            }
        }
    }
    pairs
}

/// What two views share: the mean over colours of the product of their standardised residuals.
pub fn shared([i, j]: [u32; 2], standard: &dyn Fn(usize) -> f64) -> f64 {
    let product = |c| standard(3 * i as usize + c) * standard(3 * j as usize + c);
    (0..3).map(product).sum::<f64>() / 3.0
}
