//! How far places of the surface are from the edges of shadows that the object casts on itself.
//!
//! An edge lies between neighbouring places where the share of the fitted light that the object lets pass changes most: the
//! steepest twentieth of all neighbours, if a twentieth of the light comes or goes there. Distances go along the surface, from
//! place to place. Where a place turns away from a lamp there is no edge: light fades there by itself. Occluders of the model cast
//! none: what they do is an effect's affair.

use glam::Vec3;
use rayon::prelude::*;

use super::{fit::Fit, horizon::Sources, study::Study};

/// The share of neighbours that an edge lies between.
const STEEPEST: f64 = 0.05;
/// The least change of the share of light that passes.
const LEAST: f64 = 0.05;
/// Light from lower than this over a place (cosine) does not count, light from twice that counts whole: facets of the mesh hide it
/// from smooth normals, whatever casts shadows.
const LOW: f32 = 0.15;
/// Where the cosine is taken within a texel, so that it varies as much as over the tent that transport weighs light by.
const WITHIN: [f32; 2] = [0.5 - 0.408, 0.5 + 0.408];

/// The distance of every view's site from the nearest edge in its frame, in units of the object's radius; infinite without any.
pub fn distances(study: &Study<'_>, fit: &Fit, pairs: &[[u32; 2]]) -> Vec<f64> {
    let sites = &study.seen.sites;
    let lengths: Vec<f64> = pairs
        .iter()
        .map(|pair| {
            let [a, b] = pair.map(|site| sites[site as usize].point.position);
            f64::from(a.distance(b) / study.radius.max(1e-9))
        })
        .collect();
    let from = |share: Vec<f64>| along(sites.len(), pairs, &lengths, &edges(&share, pairs));
    let by_frame: Vec<Vec<f64>> = match &fit.horizon.sources {
        Sources::Grid(_) => vec![from(of_environment(study, fit))],
        Sources::Lamps(lamps) => (0..lamps.len())
            .map(|lamp| from(of_lamp(study, fit, lamp)))
            .collect(),
    };
    let of = |frame: u32| &by_frame[frame as usize % by_frame.len().max(1)];
    let views = study.seen.views.iter();
    views
        .map(|view| of(view.frame)[view.site as usize])
        .collect()
}

/// The share of light towards each site that the object lets pass.
fn of_environment(study: &Study<'_>, fit: &Fit) -> Vec<f64> {
    let Sources::Grid(grid) = fit.horizon.sources else {
        return vec![f64::NAN; study.seen.sites.len()];
    };
    let radiance = &fit.radiance;
    let light = |texel: usize| radiance[3 * texel..3 * texel + 3].iter().sum::<f32>();
    // What the object would receive if it hid nothing: by the cosines at four directions of each texel.
    let middles: Vec<Vec3> = (0..grid.len())
        .map(|texel| grid.texel_direction(texel / grid.columns, texel % grid.columns))
        .collect();
    let rays: Vec<[Vec3; 4]> = (0..grid.len())
        .map(|texel| {
            let [a, b] = WITHIN;
            [[a, a], [a, b], [b, a], [b, b]].map(|place| {
                grid.direction_within(texel / grid.columns, texel % grid.columns, place)
            })
        })
        .collect();
    let shares = study.seen.sites.par_iter().zip(&fit.horizon.rows);
    shares
        .map(|(site, row)| {
            let normal = site.point.normal;
            let counts = |texel: usize| ((normal.dot(middles[texel]) - LOW) / LOW).clamp(0.0, 1.0);
            let entries = row.texel.iter().map(|&texel| usize::from(texel));
            let passed: f64 = entries
                .zip(&row.weight)
                .map(|(texel, weight)| f64::from(counts(texel) * weight * light(texel)))
                .sum();
            let all: f64 = (0..grid.len())
                .map(|texel| (texel, counts(texel)))
                .filter(|(_, counted)| *counted > 0.0)
                .map(|(texel, counted)| {
                    let cosines = rays[texel].iter().map(|ray| normal.dot(*ray).max(0.0));
                    let cosine = 0.25 * cosines.sum::<f32>();
                    let solid_angle = grid.solid_angle(texel / grid.columns);
                    f64::from(counted * cosine * solid_angle * light(texel))
                })
                .sum();
            (passed / all.max(1e-300)).min(1.0)
        })
        .collect()
}

/// Whether a lamp shines on each site; NaN where the site turns away from it.
fn of_lamp(study: &Study<'_>, fit: &Fit, lamp: usize) -> Vec<f64> {
    let source = fit.horizon.lamps().map(|lamps| lamps[lamp]);
    let sites = study.seen.sites.iter().zip(&fit.horizon.rows);
    sites
        .map(|(site, row)| {
            let faces = source.is_some_and(|source| {
                let (incident, _) = source.seen_from(site.point.position);
                site.point.normal.dot(incident) > LOW
            });
            match faces {
                true => f64::from(u8::from(row.texel.contains(&(lamp as u16)))),
                false => f64::NAN,
            }
        })
        .collect()
}

/// The pairs that an edge lies between.
fn edges(share: &[f64], pairs: &[[u32; 2]]) -> Vec<usize> {
    let change = |pair: &[u32; 2]| (share[pair[0] as usize] - share[pair[1] as usize]).abs();
    let changes: Vec<f64> = pairs.iter().map(change).collect();
    let mut sorted: Vec<f64> = changes.iter().copied().filter(|c| c.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let steep = (sorted.len() as f64 * (1.0 - STEEPEST)) as usize;
    let Some(steep) = sorted.get(steep) else {
        return Vec::new();
    };
    let least = steep.max(LEAST);
    (0..pairs.len()).filter(|&k| changes[k] >= least).collect()
}

/// The shortest way of each of `count` sites to the middle of one of the pairs `to`, over pairs of these lengths.
fn along(count: usize, pairs: &[[u32; 2]], lengths: &[f64], to: &[usize]) -> Vec<f64> {
    let mut distance = vec![f64::INFINITY; count];
    for &k in to {
        for site in pairs[k] {
            let own = &mut distance[site as usize];
            *own = own.min(0.5 * lengths[k]);
        }
    }
    // Every pass takes shortest ways at least one pair further.
    loop {
        let mut shorter = false;
        for (pair, length) in pairs.iter().zip(lengths) {
            let [a, b] = pair.map(|site| site as usize);
            for (here, there) in [(a, b), (b, a)] {
                if distance[here] + length < distance[there] {
                    distance[there] = distance[here] + length;
                    shorter = true;
                }
            }
        }
        if !shorter {
            return distance;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_go_along_the_surface() {
        // A chain 0 … 4 that comes back near its start, without a pair between its ends; 5 is alone.
        let pairs = [[0, 1], [1, 2], [2, 3], [3, 4]];
        let lengths = [1.0, 2.0, 1.0, 0.5];
        let distance = along(6, &pairs, &lengths, &[0]);
        assert_eq!(distance[..5], [0.5, 0.5, 2.5, 3.5, 4.0]);
        assert!(distance[5].is_infinite());
        let both = along(5, &pairs, &lengths, &[0, 3]);
        assert_eq!(both, [0.5, 0.5, 1.25, 0.25, 0.25]);
    }

    #[test]
    fn an_edge_is_where_the_share_changes_most() {
        let pairs: Vec<[u32; 2]> = (0..40).map(|k| [k, k + 1]).collect();
        let mut share: Vec<f64> = (0..41).map(|k| if k < 20 { 1.0 } else { 0.3 }).collect();
        assert_eq!(edges(&share, &pairs), [19]);
        // Light that fades evenly has no edge, nor has a place that turns away from the lamp.
        let even: Vec<f64> = (0..41).map(|k| 1.0 - 0.01 * f64::from(k)).collect();
        assert!(edges(&even, &pairs).is_empty());
        share[20] = f64::NAN;
        assert!(edges(&share, &pairs).is_empty());
        assert!(edges(&[], &[]).is_empty());
    }
}
