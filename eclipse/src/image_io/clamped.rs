//! Light that no scene has, as programs leave it in environment maps: what filters with negative lobes undershoot, and suns beyond the
//! largest number of half precision.

use std::{
    fmt::{self, Display, Formatter},
    path::{Path, PathBuf},
};

use render::image::Image;

use crate::wording::counted;

/// The largest number of half precision, which maps are mostly stored in: what a sun that is infinite at least was.
const LARGEST: f32 = 65504.0;

/// What was changed of a map to make light of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Clamped {
    /// The map's file.
    pub path: PathBuf,
    /// Texels that had negative light, which is taken as none.
    pub negative: usize,
    /// The lowest value of them.
    pub lowest: f32,
    /// Texels that had infinite light, which is taken as the largest number of half precision.
    pub infinite: usize,
}

/// Makes light of the map of the file `path`, where that takes anything; what is NaN stays, and so does −∞, since nobody knows what they
/// were.
pub(super) fn clamp(map: &mut Image, path: &Path) -> Option<Clamped> {
    let mut clamped = Clamped {
        path: path.to_owned(),
        negative: 0,
        lowest: 0.0,
        infinite: 0,
    };
    for texel in map.data.chunks_exact_mut(map.channels) {
        let is_negative = |value: &f32| *value < 0.0 && value.is_finite();
        clamped.negative += usize::from(texel.iter().any(is_negative));
        clamped.infinite += usize::from(texel.contains(&f32::INFINITY));
        for value in texel {
            if is_negative(value) {
                clamped.lowest = clamped.lowest.min(*value);
                *value = 0.0;
            } else if *value == f32::INFINITY {
                *value = LARGEST;
            }
        }
    }
    (clamped.negative + clamped.infinite > 0).then_some(clamped)
}

impl Display for Clamped {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let negative = (self.negative > 0).then(|| {
            let (texels, lowest) = (counted(self.negative, "texel"), self.lowest);
            format!("{texels} with negative light, at lowest {lowest}, taken as 0")
        });
        let infinite = (self.infinite > 0).then(|| {
            let texels = counted(self.infinite, "texel");
            format!("{texels} with infinite light, taken as {LARGEST}, the most of half precision")
        });
        let parts: Vec<String> = negative.into_iter().chain(infinite).collect();
        write!(f, "{} has {}", self.path.display(), parts.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_light_is_none_and_infinite_light_the_most_of_half_precision() {
        let mut map = Image::filled(4, 2, 3, 1.0);
        assert_eq!(clamp(&mut map, Path::new("a.exr")), None);
        map.pixel_mut(1, 0).copy_from_slice(&[-0.5, 2.0, -0.25]);
        map.pixel_mut(2, 0)[0] = -1e-6;
        map.pixel_mut(3, 1).fill(f32::INFINITY);
        // More than half precision holds, but a number.
        map.pixel_mut(0, 1)[1] = 1e6;
        let clamped = clamp(&mut map, Path::new("a.exr")).unwrap();
        assert_eq!(map.pixel(1, 0), [0.0, 2.0, 0.0]);
        assert_eq!(map.pixel(2, 0), [0.0, 1.0, 1.0]);
        assert_eq!(map.pixel(3, 1), [65504.0; 3]);
        assert_eq!(map.pixel(0, 1), [1.0, 1e6, 1.0]);
        assert_eq!(
            clamped.to_string(),
            "a.exr has 2 texels with negative light, at lowest -0.5, taken as 0; 1 texel with infinite light, taken as 65504, the most \
             of half precision"
        );
    }

    #[test]
    fn what_is_no_number_stays() {
        let mut map = Image::filled(2, 1, 3, 1.0);
        map.pixel_mut(0, 0)[0] = f32::NAN;
        map.pixel_mut(1, 0)[0] = f32::NEG_INFINITY;
        assert_eq!(clamp(&mut map, Path::new("a.exr")), None);
        assert!(map.pixel(0, 0)[0].is_nan());
        assert_eq!(map.pixel(1, 0)[0], f32::NEG_INFINITY);
    }
}
