//! What is sealed, what is developed on: patches of surface with gutters between them, and whole frames.
//!
//! A patch is held out in every frame at once. Its sites' albedos are then unknown to the fit, so that an effect cannot
//! win by letting each site have a shade of its own; it has to say something that carries over to other parts of the object.

use glam::Vec3;

/// Parts the surface is cut into.
const PATCHES: usize = 48;
/// One in so many patches is sealed, about 15 %.
const SEALED_PATCH: usize = 7;
/// One in so many frames is sealed, about 15 %.
const SEALED_FRAME: usize = 7;
/// Folds of the development data.
pub const FOLDS: usize = 6;
/// A site is in the gutter when a patch of the other kind is nearer than this many times the distance to its own.
const GUTTER: f32 = 1.15;

/// Where on the surface a site lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Its patch.
    pub patch: u16,
    /// Whether it is close to a border between sealed patches and others.
    pub gutter: bool,
}

/// What an observation may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Fit and compare, in this fold.
    Development(u8),
    /// Looked at once, at the end: on a sealed patch, in a frame that takes part in the fit.
    SealedPatch,
    /// Looked at once, at the end: in a sealed frame.
    SealedFrame,
    /// Never: too close to a border between the two.
    Gutter,
}

/// Cuts the surface into patches around points that are far from each other; the number of patches comes second.
pub fn places(positions: &[Vec3]) -> (Vec<Place>, usize) {
    if positions.is_empty() {
        return (Vec::new(), 0);
    }
    let seeds = farthest(positions, PATCHES.min(positions.len()));
    let places = positions
        .iter()
        .map(|p| {
            let mut near: Vec<(f32, u16)> = seeds
                .iter()
                .enumerate()
                .map(|(i, &s)| (positions[s].distance(*p), i as u16))
                .collect();
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let sealed = patch_sealed(near[0].1);
            // Where three patches meet, the one of the other kind need not be the second nearest.
            let gutter = near
                .iter()
                .take_while(|other| other.0 < GUTTER * near[0].0)
                .any(|other| patch_sealed(other.1) != sealed);
            Place {
                patch: near[0].1,
                gutter,
            }
        })
        .collect();
    (places, seeds.len())
}

/// Indices of `count` points, each as far as possible from those before it.
pub fn farthest(positions: &[Vec3], count: usize) -> Vec<usize> {
    let mut chosen = vec![0];
    let mut nearest = vec![f32::INFINITY; positions.len()];
    while chosen.len() < count.min(positions.len()) {
        let last = positions[chosen[chosen.len() - 1]];
        for (near, p) in nearest.iter_mut().zip(positions) {
            *near = near.min(p.distance_squared(last));
        }
        let next = (0..positions.len())
            .max_by(|&a, &b| nearest[a].total_cmp(&nearest[b]).then(b.cmp(&a)))
            .unwrap_or(0);
        chosen.push(next);
    }
    chosen
}

/// Whether a frame is sealed. Captures of a few frames keep all of them: there the patches alone are judged.
pub fn frame_sealed(frame: u32, frames: usize) -> bool {
    frames >= 12 && frame as usize % SEALED_FRAME == SEALED_FRAME / 2
}

fn patch_sealed(patch: u16) -> bool {
    // Farthest points come in an order without spatial pattern.
    usize::from(patch) % SEALED_PATCH == SEALED_PATCH / 2
}

/// What a view of a site may be used for.
pub fn role(place: Place, frame: u32, frames: usize) -> Role {
    let sealed = patch_sealed(place.patch);
    if place.gutter {
        Role::Gutter
    } else if frame_sealed(frame, frames) {
        // Of a sealed patch nobody knows the albedo, so that its views in a sealed frame tell nothing about the frame.
        if sealed {
            Role::Gutter
        } else {
            Role::SealedFrame
        }
    } else if sealed {
        Role::SealedPatch
    } else {
        Role::Development((usize::from(place.patch) / 2 % FOLDS) as u8)
    }
}

/// What a part of the background may be used for.
pub fn dark_role(patch: u32, frame: u32, frames: usize) -> Role {
    let key = patch.wrapping_mul(0x9e37_79b9) >> 16;
    if frame_sealed(frame, frames) {
        Role::SealedFrame
    } else if (key as usize).is_multiple_of(SEALED_PATCH) {
        Role::SealedPatch
    } else {
        Role::Development((key as usize % FOLDS) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_are_sealed_whole_and_gutters_part_them() {
        let points: Vec<Vec3> = (0..16000)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / 16000.0;
                let phi = i as f32 * 2.399_963;
                let r = (1.0 - z * z).sqrt();
                Vec3::new(r * phi.cos(), r * phi.sin(), z)
            })
            .collect();
        let (places, count) = places(&points);
        assert_eq!(count, PATCHES);
        let roles: Vec<Role> = places.iter().map(|&p| role(p, 0, 24)).collect();
        let share = |wanted: fn(&Role) -> bool| {
            roles.iter().filter(|r| wanted(r)).count() as f64 / roles.len() as f64
        };
        let sealed = share(|r| matches!(r, Role::SealedPatch));
        assert!((0.05..0.2).contains(&sealed), "{sealed}");
        // Neighbours, a twentieth of a patch apart, that lie on either side of a border: with gutters, and were there none.
        let [mut parted, mut touching] = [0, 0];
        for (i, a) in points.iter().enumerate() {
            for (j, b) in points.iter().enumerate().take(i) {
                if a.distance(*b) > 0.03
                    || patch_sealed(places[i].patch) == patch_sealed(places[j].patch)
                {
                    continue;
                }
                touching += 1;
                parted += usize::from(roles[i] != Role::Gutter && roles[j] != Role::Gutter);
            }
        }
        assert!(
            touching > 100 && 50 * parted < touching,
            "{parted} of {touching}"
        );
        assert!((0..24).filter(|&t| frame_sealed(t, 24)).count() >= 3);
        assert!(!frame_sealed(3, 8));
    }
}
