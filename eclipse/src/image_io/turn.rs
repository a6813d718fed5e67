//! How a photograph is shown: a camera that is held upright may store its picture lying, and say so (EXIF `Orientation`).

use std::path::Path;

use render::image::Image;

use super::{openexr, raster, read_bytes};

/// A quarter turn by which a stored picture is shown, mirrored or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// The value of EXIF's `Orientation`, 5 to 8: those that exchange width and height.
    exif: u8,
}

/// The quarter turn that the image file `path` asks for, where it does; `None` as well for a file that cannot be read.
pub fn read_turn(path: &Path) -> Option<Turn> {
    decode_turn(&read_bytes(path).ok()?, path)
}

/// [`read_turn`] from bytes; `path` names them, and is not read.
pub fn decode_turn(bytes: &[u8], path: &Path) -> Option<Turn> {
    if bytes.starts_with(&openexr::MAGIC) {
        return None;
    }
    Turn::of(raster::orientation(bytes, path)?)
}

impl Turn {
    fn of(exif: u8) -> Option<Self> {
        (5..=8).contains(&exif).then_some(Self { exif })
    }

    /// The value of EXIF's `Orientation`.
    pub fn exif(self) -> u8 {
        self.exif
    }

    /// The stored picture as it is shown.
    pub fn shown(self, stored: &Image) -> Image {
        let [width, height] = [stored.height, stored.width];
        let mut shown = Image::filled(width, height, stored.channels, 0.0);
        for y in 0..height {
            for x in 0..width {
                let (across, down) = (height - 1 - y, width - 1 - x);
                let [column, row] = match self.exif {
                    5 => [y, x],
                    6 => [y, down],
                    7 => [across, down],
                    _ => [across, x],
                };
                let pixel = stored.pixel(column, row);
                shown.pixel_mut(x, y).copy_from_slice(pixel);
            }
        }
        shown
    }
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, GrayImage, metadata::Orientation};

    use super::*;

    #[test]
    fn pictures_are_turned_as_others_turn_them() {
        let stored = Image {
            width: 3,
            height: 2,
            channels: 1,
            data: (0..6_u8).map(f32::from).collect(),
        };
        for exif in 5..=8 {
            let picture = GrayImage::from_raw(3, 2, (0..6).collect()).unwrap();
            let mut picture = DynamicImage::from(picture);
            picture.apply_orientation(Orientation::from_exif(exif).unwrap());
            let shown = Turn::of(exif).unwrap().shown(&stored);
            assert_eq!([shown.width, shown.height], [2, 3]);
            let expected: Vec<f32> = picture.as_bytes().iter().copied().map(f32::from).collect();
            assert_eq!(shown.data, expected, "{exif}");
        }
        assert!(
            [0, 1, 3, 9]
                .into_iter()
                .all(|exif| Turn::of(exif).is_none())
        );
    }
}
